//! `_core.Arm`.

use numpy::IntoPyArray;
use octoarm_arm::memory::filled;
use octoarm_arm::{
    Actuator, ArmParameters, ArmState, COORDINATES, DomainError, LinearReadout, check_command,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::arrays::{Joints, Table, Vector, joints_array, numbers, pairs_of, shaped, table};
use crate::errors::{interruptible, invalid, left_domain};

/// Steps between two looks at Python's signals, for one arm of one compartment: a tenth of a second.
const BLOCK: usize = 1 << 17;

/// Fewest steps between two looks: with fewer, fetching the states of many arms into the cache anew for
/// every block would cost a tenth.
const FEWEST: usize = 32;

/// Steps between two looks at Python's signals that so many arms make.
pub(crate) fn block(arms: usize, compartments: usize) -> usize {
    (BLOCK / (arms * compartments)).max(FEWEST)
}

/// Coordinates, rates, base, step count and muscle inputs of an arm.
pub(crate) type State<'py> = (Table<'py>, Table<'py>, Vector<'py>, u64, (Table<'py>, Table<'py>));
/// The same as Python gives it.
pub(crate) type GivenState<'py> = (
    Bound<'py, PyAny>,
    Bound<'py, PyAny>,
    Bound<'py, PyAny>,
    u64,
    (Bound<'py, PyAny>, Bound<'py, PyAny>),
);

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

/// A state as Python sees it.
pub(crate) fn state_of(py: Python<'_>, state: ArmState) -> PyResult<State<'_>> {
    let muscles = |first: usize| {
        let mut inputs = vec![0.0; 4 * state.coordinates.len()];
        for (values, row) in inputs.chunks_exact_mut(4).zip(&state.muscles) {
            values.copy_from_slice(&row[first..first + 4]);
        }
        table(py, inputs, 4)
    };
    let muscles = (muscles(0)?, muscles(4)?);
    Ok((
        table(py, state.coordinates.into_flattened(), COORDINATES)?,
        table(py, state.rates.into_flattened(), COORDINATES)?,
        state.base.to_vec().into_pyarray(py),
        state.steps,
        muscles,
    ))
}

/// A state from what Python gives for one.
pub(crate) fn state_from(compartments: usize, given: &GivenState<'_>) -> PyResult<ArmState> {
    let (coordinates, rates, base, steps, (longitudinal, transverse)) = given;
    let read = |name: &str, value, columns| {
        numbers(name, value, &[Some(compartments), Some(columns)]).map(|(flat, _)| flat)
    };
    let coordinates = read("state.coordinates", coordinates, COORDINATES)?;
    let rates = read("state.rates", rates, COORDINATES)?;
    let (base, _) = numbers("state.base", base, &[Some(4)])?;
    let longitudinal = read("state.muscles[0]", longitudinal, 4)?;
    let transverse = read("state.muscles[1]", transverse, 4)?;
    let muscles = longitudinal.as_chunks::<4>().0.iter().zip(transverse.as_chunks::<4>().0);
    Ok(ArmState {
        coordinates: coordinates.as_chunks().0.to_vec(),
        rates: rates.as_chunks().0.to_vec(),
        base: std::array::from_fn(|index| base[index]),
        steps: *steps,
        muscles: muscles
            .map(|(xi, delta)| std::array::from_fn(|i| if i < 4 { xi[i] } else { delta[i - 4] }))
            .collect(),
    })
}

impl Arm {
    pub(crate) fn inner(&self) -> &octoarm_arm::Arm {
        &self.inner
    }

    fn block(&self) -> usize {
        block(1, self.inner.parameters().compartments)
    }

    /// Runs block after block, each with its number of steps; gives the number of steps made, and what
    /// ended them early. An interrupt puts the arm back to where it was.
    fn blocks<B: Send>(
        &mut self,
        py: Python<'_>,
        blocks: impl Iterator<Item = B>,
        mut run: impl FnMut(&mut octoarm_arm::Arm, B) -> (usize, Result<(), (usize, DomainError)>)
        + Send,
    ) -> PyResult<(usize, Option<DomainError>)> {
        // What is one block long has ended before Python looks at its signals again.
        let before = (blocks.size_hint().0 > 1).then(|| self.inner.state());
        let mut done = 0;
        for block in blocks {
            let (steps, made) = py.detach(|| run(&mut self.inner, block));
            if let Err((step, failure)) = made {
                return Ok((done + step, Some(failure)));
            }
            done += steps;
            if let Some(before) = &before
                && let Err(interrupt) = py.check_signals()
            {
                self.inner.set_state(before).map_err(invalid)?;
                return Err(interrupt);
            }
        }
        Ok((done, None))
    }
}

#[pymethods]
impl Arm {
    #[new]
    fn new(py: Python<'_>, parameters: &str, actuator: &str, undeformed: bool) -> PyResult<Self> {
        let actuator = self::actuator(actuator)?;
        let parameters = ArmParameters::from_json(parameters).map_err(invalid)?;
        let make = if undeformed { octoarm_arm::Arm::undeformed } else { octoarm_arm::Arm::new };
        let inner = interruptible(py, || make(parameters, actuator))?;
        Ok(Self { inner })
    }

    fn reset(&mut self, py: Python<'_>, undeformed: bool) -> PyResult<()> {
        if undeformed {
            self.inner.reset_undeformed();
            Ok(())
        } else {
            interruptible(py, || self.inner.reset())
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
        let (angles, _) = numbers("angles", angles, &[None, Some(2)])?;
        let commands = pairs_of(&angles);
        for (row, command) in commands.iter().enumerate() {
            check_command(*command)
                .map_err(|error| PyValueError::new_err(format!("angles[{row}]: {error}")))?;
        }
        let width = self.inner.observation_len();
        let what = format!("spring lengths of {} steps", commands.len());
        let mut lengths = filled(&what, 0.0, commands.len().checked_mul(width)).map_err(invalid)?;
        let outs = lengths.chunks_mut(self.block() * width);
        let blocks = commands.chunks(self.block()).zip(outs);
        let (done, failure) = self.blocks(py, blocks, |inner, (commands, out)| {
            (commands.len(), inner.run(commands, out))
        })?;
        lengths.truncate(done * width);
        let lengths = table(py, lengths, width)?;
        match failure {
            None => Ok(lengths),
            Some(failure) => Err(left_domain(py, &failure, done, Some(lengths.into_any()), None)),
        }
    }

    #[pyo3(signature = (weights, steps, perturbation=None))]
    fn run_closed_loop<'py>(
        &mut self,
        py: Python<'py>,
        weights: &Bound<'py, PyAny>,
        steps: usize,
        perturbation: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<(Table<'py>, Table<'py>)> {
        let width = self.inner.observation_len();
        let columns = [2, 2 + width, 2 + 2 * width];
        let (flat, shape) =
            shaped("weights", weights, &columns.map(|each| vec![None, Some(each)]))?;
        let said = shape[1];
        let readouts: Vec<LinearReadout> = (0..said / 2)
            .map(|pair| {
                let rows: Vec<[f64; 2]> =
                    flat.chunks_exact(said).map(|row| [row[2 * pair], row[2 * pair + 1]]).collect();
                LinearReadout::from_rows(&rows, width).map_err(invalid)
            })
            .collect::<PyResult<_>>()?;
        let push = perturbation
            .map(|value| numbers("perturbation", value, &[None, Some(2)]).map(|(flat, _)| flat))
            .transpose()?;
        if let Some(rows) = push.as_ref().filter(|rows| rows.len() / 2 != steps) {
            return Err(PyValueError::new_err(format!(
                "perturbation has shape ({}, 2), expected ({steps}, 2): one row a step",
                rows.len() / 2
            )));
        }
        let what = format!("steps = {steps}");
        let mut lengths = filled(&what, 0.0, steps.checked_mul(width)).map_err(invalid)?;
        let mut outputs = filled(&what, 0.0, steps.checked_mul(said)).map_err(invalid)?;
        let block = self.block();
        let blocks =
            outputs.chunks_mut(block * said).zip(lengths.chunks_mut(block * width)).enumerate();
        let (done, failed) = self.blocks(py, blocks, |inner, (index, (outputs, out))| {
            let made = outputs.len() / said;
            let push = push.as_ref().map(|rows| &pairs_of(rows)[index * block..][..made]);
            let end = match readouts.as_slice() {
                [readout] => inner.run_closed_loop(readout, push, outputs.as_chunks_mut().0, out),
                many => inner.run_muscle_loop(many, push, outputs, out),
            };
            (made, end)
        })?;
        outputs.truncate(done * said);
        lengths.truncate(done * width);
        let outputs = table(py, outputs, said)?;
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

    fn linearise<'py>(
        &self,
        py: Python<'py>,
        theta: f64,
        phi: f64,
    ) -> PyResult<(Table<'py>, Table<'py>, Table<'py>)> {
        check_command([theta, phi]).map_err(invalid)?;
        let map = py
            .detach(|| self.inner.linearise([theta, phi]))
            .map_err(|failure| left_domain(py, &failure, 0, None, None))?;
        let of = |matrix: octoarm_arm::Matrix<f64>| {
            table(py, matrix.transpose().as_slice().to_vec(), matrix.ncols())
        };
        Ok((of(map.state)?, of(map.command)?, of(map.lengths)?))
    }

    fn get_state<'py>(&self, py: Python<'py>) -> PyResult<State<'py>> {
        state_of(py, self.inner.state())
    }

    fn set_state(&mut self, state: GivenState<'_>) -> PyResult<()> {
        let state = state_from(self.inner.parameters().compartments, &state)?;
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
