//! `_core.ArmBatch`.

use numpy::{IntoPyArray, PyArray1, PyArray3, PyArrayMethods};
use octoarm_arm::memory::filled;
use octoarm_arm::{ArmState, LinearReadout};
use octoarm_env::Stop;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyList;

use crate::arm::{Arm, GivenState, State, block, state_from, state_of};
use crate::arrays::{Table, numbers, pairs_of, shaped, table};
use crate::errors::{invalid, left_domain};

type Cube<'py> = Bound<'py, PyArray3<f64>>;
/// Steps that every arm has made, and why it made no more.
type Ends<'py> = (Bound<'py, PyArray1<i64>>, Bound<'py, PyList>);

/// Many arms; `octoarm_env.ArmBatch` documents it.
#[pyclass(module = "octoarm_env._core")]
pub(crate) struct ArmBatch {
    inner: octoarm_env::ArmBatch,
}

/// Rows of an array (T, 2), the same for every arm, or (N, T, 2).
struct Rows {
    flat: Vec<f64>,
    steps: usize,
    shared: bool,
}

impl Rows {
    fn read(name: &str, value: &Bound<'_, PyAny>, arms: usize) -> PyResult<Self> {
        let shapes = [vec![None, Some(2)], vec![Some(arms), None, Some(2)]];
        let (flat, shape) = shaped(name, value, &shapes)?;
        let shared = shape.len() == 2;
        Ok(Self { flat, steps: shape[shape.len() - 2], shared })
    }

    fn of(&self, arm: usize) -> &[[f64; 2]] {
        let rows = pairs_of(&self.flat);
        if self.shared { rows } else { &rows[arm * self.steps..][..self.steps] }
    }
}

fn ends<'py>(py: Python<'py>, stops: &[Option<Stop>], steps: usize) -> PyResult<Ends<'py>> {
    let made: Vec<i64> =
        stops.iter().map(|stop| stop.map_or(steps, |(step, _)| step) as i64).collect();
    let failures = PyList::empty(py);
    for stop in stops {
        match stop {
            None => failures.append(py.None())?,
            Some((step, failure)) => {
                failures.append(left_domain(py, failure, *step, None, None).value(py))?;
            }
        }
    }
    Ok((made.into_pyarray(py), failures))
}

impl ArmBatch {
    /// Runs block after block; `run` gets the steps of a block and its rows of lengths. An interrupt
    /// puts the arms back to where they were.
    fn blocks(
        &mut self,
        py: Python<'_>,
        steps: usize,
        stride: usize,
        mut run: impl FnMut(
            &mut octoarm_env::ArmBatch,
            std::ops::Range<usize>,
            Vec<&mut [f64]>,
            &mut [Option<Stop>],
        ) + Send,
    ) -> PyResult<(Vec<f64>, Vec<Option<Stop>>)> {
        let (arms, width) = (self.inner.len(), self.inner.observation_len());
        let rows = steps / stride;
        let cells = rows.checked_mul(width).and_then(|cells| cells.checked_mul(arms));
        let what = format!("spring lengths of {steps} steps of {arms} arms");
        let mut lengths = filled(&what, 0.0, cells).map_err(invalid)?;
        let mut stops: Vec<Option<Stop>> = vec![None; arms];
        let size = block(arms, width / 4);
        let before = if steps > size { self.inner.states() } else { Vec::new() };
        for begin in (0..steps).step_by(size) {
            let block = begin..steps.min(begin + size);
            let (from, to) = (block.start / stride * width, block.end / stride * width);
            let out = if rows == 0 {
                (0..arms).map(|_| <&mut [f64]>::default()).collect()
            } else {
                lengths.chunks_exact_mut(rows * width).map(|arm| &mut arm[from..to]).collect()
            };
            let (inner, stops) = (&mut self.inner, &mut stops);
            py.detach(|| run(inner, block.clone(), out, stops));
            // The last block is followed by Python's own look at signals.
            if block.end < steps
                && let Err(interrupt) = py.check_signals()
            {
                self.inner.set_states(before.iter()).map_err(invalid)?;
                return Err(interrupt);
            }
        }
        Ok((lengths, stops))
    }

    fn cube<'py>(&self, py: Python<'py>, flat: Vec<f64>, columns: usize) -> PyResult<Cube<'py>> {
        let rows = flat.len() / (self.inner.len() * columns);
        flat.into_pyarray(py).reshape([self.inner.len(), rows, columns])
    }
}

#[pymethods]
impl ArmBatch {
    #[new]
    fn new(arms: Vec<PyRef<'_, Arm>>, threads: Option<usize>) -> PyResult<Self> {
        let arms: Vec<&octoarm_arm::Arm> = arms.iter().map(|arm| arm.inner()).collect();
        let inner = octoarm_env::ArmBatch::new(&arms, threads).map_err(invalid)?;
        Ok(Self { inner })
    }

    #[getter]
    fn lengths<'py>(&self, py: Python<'py>) -> PyResult<Table<'py>> {
        table(py, self.inner.lengths(), self.inner.observation_len())
    }

    fn run<'py>(
        &mut self,
        py: Python<'py>,
        angles: &Bound<'py, PyAny>,
        stride: usize,
    ) -> PyResult<(Cube<'py>, Ends<'py>)> {
        let angles = Rows::read("angles", angles, self.inner.len())?;
        for (row, command) in pairs_of(&angles.flat).iter().enumerate() {
            octoarm_arm::check_command(*command).map_err(|error| {
                let (arm, step) = (row / angles.steps, row % angles.steps);
                let place =
                    if angles.shared { format!("[{row}]") } else { format!("[{arm}, {step}]") };
                PyValueError::new_err(format!("angles{place}: {error}"))
            })?;
        }
        let steps = angles.steps;
        let arms = self.inner.len();
        let (lengths, stops) = self.blocks(py, steps, stride, |inner, block, lengths, stops| {
            let commands: Vec<&[[f64; 2]]> = (0..arms).map(|arm| angles.of(arm)).collect();
            inner.run(&commands, block, stride, lengths, stops);
        })?;
        let width = self.inner.observation_len();
        Ok((self.cube(py, lengths, width)?, ends(py, &stops, steps)?))
    }

    fn run_closed_loop<'py>(
        &mut self,
        py: Python<'py>,
        weights: &Bound<'py, PyAny>,
        steps: usize,
        perturbation: Option<&Bound<'py, PyAny>>,
        stride: usize,
    ) -> PyResult<(Cube<'py>, Cube<'py>, Ends<'py>)> {
        let (arms, width) = (self.inner.len(), self.inner.observation_len());
        let shapes = [
            vec![Some(width), Some(2)],
            vec![Some(width + 1), Some(2)],
            vec![Some(arms), Some(width), Some(2)],
            vec![Some(arms), Some(width + 1), Some(2)],
        ];
        let (flat, shape) = shaped("weights", weights, &shapes)?;
        let rows = shape[shape.len() - 2];
        let readouts: Vec<LinearReadout> = flat
            .chunks_exact(2 * rows)
            .map(|flat| LinearReadout::from_rows(pairs_of(flat), width).map_err(invalid))
            .collect::<PyResult<_>>()?;
        let readouts: Vec<&LinearReadout> =
            (0..arms).map(|arm| &readouts[if shape.len() == 2 { 0 } else { arm }]).collect();
        let perturbation =
            perturbation.map(|value| Rows::read("perturbation", value, arms)).transpose()?;
        if let Some(rows) = perturbation.as_ref().filter(|rows| rows.steps != steps) {
            return Err(PyValueError::new_err(format!(
                "perturbation has {} rows, expected {steps}: one a step",
                rows.steps
            )));
        }
        let what = format!("outputs of {steps} steps of {arms} arms");
        let mut outputs = filled(&what, [0.0; 2], steps.checked_mul(arms)).map_err(invalid)?;
        let said = &mut outputs;
        let (lengths, stops) = self.blocks(py, steps, stride, |inner, block, lengths, stops| {
            let push: Option<Vec<&[[f64; 2]]>> =
                perturbation.as_ref().map(|rows| (0..arms).map(|arm| rows.of(arm)).collect());
            let said = said.chunks_exact_mut(steps).map(|arm| &mut arm[block.clone()]).collect();
            let push = push.as_deref();
            inner.run_closed_loop(&readouts, push, block, stride, said, lengths, stops);
        })?;
        let outputs = self.cube(py, outputs.into_flattened(), 2)?;
        Ok((outputs, self.cube(py, lengths, width)?, ends(py, &stops, steps)?))
    }

    fn get_muscles<'py>(&self, py: Python<'py>) -> PyResult<(Cube<'py>, Cube<'py>)> {
        let shape = [self.inner.len(), self.inner.observation_len() / 4, 4];
        let (longitudinal, transverse) = self.inner.muscles();
        let cube = |flat: Vec<f64>| flat.into_pyarray(py).reshape(shape);
        Ok((cube(longitudinal)?, cube(transverse)?))
    }

    fn set_muscles(
        &mut self,
        longitudinal: &Bound<'_, PyAny>,
        transverse: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let shape = [Some(self.inner.len()), Some(self.inner.observation_len() / 4), Some(4)];
        let (longitudinal, _) = numbers("longitudinal", longitudinal, &shape)?;
        let (transverse, _) = numbers("transverse", transverse, &shape)?;
        self.inner.set_muscles(&longitudinal, &transverse).map_err(invalid)
    }

    fn get_states<'py>(&self, py: Python<'py>) -> PyResult<Vec<State<'py>>> {
        self.inner.states().into_iter().map(|state| state_of(py, state)).collect()
    }

    fn set_states(&mut self, states: Vec<GivenState<'_>>) -> PyResult<()> {
        let compartments = self.inner.observation_len() / 4;
        let states: Vec<ArmState> =
            states.iter().map(|state| state_from(compartments, state)).collect::<PyResult<_>>()?;
        self.inner.set_states(states.iter()).map_err(invalid)
    }
}
