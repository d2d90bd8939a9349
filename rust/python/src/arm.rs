//! `_core.Arm`.

use numpy::IntoPyArray;
use octoarm_arm::{Actuator, ArmParameters, ArmState, COORDINATES, LinearReadout, check_command};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::arrays::{Joints, Table, Vector, joints_array, numbers, pairs, table};
use crate::errors::{invalid, left_domain};

/// Steps between two looks at Python's signals.
const BLOCK: usize = 8192;

/// Coordinates, rates, base and step count of an arm.
pub(crate) type State<'py> = (Table<'py>, Table<'py>, Vector<'py>, u64);

/// One arm; `octoarm_env.Arm` documents it.
#[pyclass(module = "octoarm_env._core")]
pub(crate) struct Arm {
    inner: octoarm_arm::Arm,
}

fn actuator(name: &str) -> PyResult<Actuator> {
    match name {
        "direct" => Ok(Actuator::Direct),
        "servo" => Ok(Actuator::Servo),
        other => Err(PyValueError::new_err(format!(
            "actuator = {other:?}: expected \"direct\" or \"servo\""
        ))),
    }
}

fn rows(flat: &[f64]) -> Vec<[f64; COORDINATES]> {
    flat.chunks_exact(COORDINATES).map(|row| std::array::from_fn(|index| row[index])).collect()
}

/// A state as Python sees it.
pub(crate) fn state_of(py: Python<'_>, state: ArmState) -> PyResult<State<'_>> {
    Ok((
        table(py, state.coordinates.into_flattened(), COORDINATES)?,
        table(py, state.rates.into_flattened(), COORDINATES)?,
        state.base.to_vec().into_pyarray(py),
        state.steps,
    ))
}

/// A state from what Python gives for one.
pub(crate) fn state_from(
    compartments: usize,
    coordinates: &Bound<'_, PyAny>,
    rates: &Bound<'_, PyAny>,
    base: &Bound<'_, PyAny>,
    steps: u64,
) -> PyResult<ArmState> {
    let shape = [Some(compartments), Some(COORDINATES)];
    let (coordinates, _) = numbers("state.coordinates", coordinates, &shape)?;
    let (rates, _) = numbers("state.rates", rates, &shape)?;
    let (base, _) = numbers("state.base", base, &[Some(4)])?;
    Ok(ArmState {
        coordinates: rows(&coordinates),
        rates: rows(&rates),
        base: std::array::from_fn(|index| base[index]),
        steps,
    })
}

impl Arm {
    pub(crate) fn inner(&self) -> &octoarm_arm::Arm {
        &self.inner
    }
}

#[pymethods]
impl Arm {
    #[new]
    fn new(py: Python<'_>, parameters: &str, actuator: &str, undeformed: bool) -> PyResult<Self> {
        let actuator = self::actuator(actuator)?;
        let parameters = ArmParameters::from_json(parameters).map_err(invalid)?;
        let make = if undeformed { octoarm_arm::Arm::undeformed } else { octoarm_arm::Arm::new };
        let inner = py.detach(|| make(parameters, actuator)).map_err(invalid)?;
        Ok(Self { inner })
    }

    fn reset(&mut self, py: Python<'_>, undeformed: bool) -> PyResult<()> {
        if undeformed {
            self.inner.reset_undeformed();
            Ok(())
        } else {
            py.detach(|| self.inner.reset()).map_err(invalid)
        }
    }

    #[getter]
    fn lengths<'py>(&self, py: Python<'py>) -> Vector<'py> {
        self.inner.lengths().into_pyarray(py)
    }

    fn step<'py>(&mut self, py: Python<'py>, theta: f64, phi: f64) -> PyResult<Vector<'py>> {
        check_command([theta, phi]).map_err(invalid)?;
        match py.detach(|| self.inner.step([theta, phi])) {
            Ok(()) => Ok(self.lengths(py)),
            Err(failure) => Err(left_domain(py, &failure, 0, None, None)),
        }
    }

    fn run<'py>(&mut self, py: Python<'py>, angles: &Bound<'py, PyAny>) -> PyResult<Table<'py>> {
        let commands = pairs("angles", angles)?;
        for (row, command) in commands.iter().enumerate() {
            check_command(*command)
                .map_err(|error| PyValueError::new_err(format!("angles[{row}]: {error}")))?;
        }
        let width = self.inner.observation_len();
        let mut lengths = vec![0.0; commands.len() * width];
        let mut done = 0;
        for (block, out) in commands.chunks(BLOCK).zip(lengths.chunks_mut(BLOCK * width)) {
            if let Err((step, failure)) = py.detach(|| self.inner.run(block, out)) {
                done += step;
                lengths.truncate(done * width);
                let lengths = table(py, lengths, width)?.into_any();
                return Err(left_domain(py, &failure, done, Some(lengths), None));
            }
            done += block.len();
            py.check_signals()?;
        }
        table(py, lengths, width)
    }

    #[pyo3(signature = (weights, steps, perturbation=None))]
    fn run_closed_loop<'py>(
        &mut self,
        py: Python<'py>,
        weights: &Bound<'py, PyAny>,
        steps: i64,
        perturbation: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<(Table<'py>, Table<'py>)> {
        let steps = usize::try_from(steps).map_err(|_| {
            PyValueError::new_err(format!("steps = {steps}: expected a number of steps, 0 or more"))
        })?;
        let width = self.inner.observation_len();
        let mut weights = pairs("weights", weights)?;
        if weights.len() != width && weights.len() != width + 1 {
            return Err(PyValueError::new_err(format!(
                "weights has shape ({}, 2), expected ({width}, 2) or ({}, 2), the last row being the bias",
                weights.len(),
                width + 1
            )));
        }
        let bias = if weights.len() > width { weights.pop().unwrap_or_default() } else { [0.0; 2] };
        let readout = LinearReadout { weights, bias };
        let perturbation = perturbation.map(|value| pairs("perturbation", value)).transpose()?;
        if let Some(rows) = &perturbation
            && rows.len() != steps
        {
            return Err(PyValueError::new_err(format!(
                "perturbation has shape ({}, 2), expected ({steps}, 2): one row a step",
                rows.len()
            )));
        }
        let cells = steps
            .checked_mul(width)
            .filter(|cells| *cells <= isize::MAX as usize / 8)
            .ok_or_else(|| PyValueError::new_err(format!("steps = {steps} is too large")))?;
        let mut outputs = Vec::new();
        let mut lengths: Vec<f64> = Vec::new();
        if lengths.try_reserve_exact(cells).is_err() || outputs.try_reserve_exact(steps).is_err() {
            return Err(PyValueError::new_err(format!("steps = {steps}: not enough memory")));
        }
        outputs.resize(steps, [0.0; 2]);
        lengths.resize(cells, 0.0);
        let mut done = 0;
        let mut failed = None;
        for (said, out) in outputs.chunks_mut(BLOCK).zip(lengths.chunks_mut(BLOCK * width)) {
            let push = perturbation.as_ref().map(|rows| &rows[done..done + said.len()]);
            let count = said.len();
            let result = py.detach(|| self.inner.run_closed_loop(&readout, push, said, out));
            if let Err((step, failure)) = result {
                done += step;
                failed = Some(failure);
                break;
            }
            done += count;
            py.check_signals()?;
        }
        outputs.truncate(done);
        lengths.truncate(done * width);
        let outputs = table(py, outputs.into_flattened(), 2)?;
        let lengths = table(py, lengths, width)?;
        match failed {
            None => Ok((outputs, lengths)),
            Some(failure) => Err(left_domain(
                py,
                &failure,
                done,
                Some(lengths.into_any()),
                Some(outputs.into_any()),
            )),
        }
    }

    fn get_state<'py>(&self, py: Python<'py>) -> PyResult<State<'py>> {
        state_of(py, self.inner.state())
    }

    fn set_state(
        &mut self,
        coordinates: &Bound<'_, PyAny>,
        rates: &Bound<'_, PyAny>,
        base: &Bound<'_, PyAny>,
        steps: u64,
    ) -> PyResult<()> {
        let compartments = self.inner.parameters().compartments;
        let state = state_from(compartments, coordinates, rates, base, steps)?;
        self.inner.set_state(&state).map_err(invalid)
    }

    fn get_muscles<'py>(&self, py: Python<'py>) -> PyResult<(Table<'py>, Table<'py>)> {
        let (longitudinal, transverse) = self.inner.muscles();
        Ok((table(py, longitudinal, 4)?, table(py, transverse, 4)?))
    }

    fn set_muscles(
        &mut self,
        longitudinal: &Bound<'_, PyAny>,
        transverse: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let shape = [Some(self.inner.parameters().compartments), Some(4)];
        let (longitudinal, _) = numbers("longitudinal", longitudinal, &shape)?;
        let (transverse, _) = numbers("transverse", transverse, &shape)?;
        self.inner.set_muscles(&longitudinal, &transverse).map_err(invalid)
    }

    fn energy(&self) -> (f64, f64) {
        let energy = self.inner.energy();
        (energy.kinetic, energy.elastic)
    }

    #[getter]
    fn joints<'py>(&self, py: Python<'py>) -> PyResult<Joints<'py>> {
        joints_array(py, self.inner.joints())
    }

    #[getter]
    fn positions<'py>(&self, py: Python<'py>) -> PyResult<Table<'py>> {
        table(py, self.inner.positions().into_flattened(), 3)
    }

    #[getter]
    fn time(&self) -> f64 {
        self.inner.time()
    }

    #[getter]
    fn base_angles<'py>(&self, py: Python<'py>) -> Vector<'py> {
        self.inner.base_degrees().to_vec().into_pyarray(py)
    }
}
