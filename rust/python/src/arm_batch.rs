//! `_core.ArmBatch`.

use numpy::{IntoPyArray, PyArray1, PyArray3, PyArrayMethods};
use octoarm_arm::{ArmState, LinearReadout};
use octoarm_env::Stop;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyList;

use crate::arm::{Arm, State, state_from, state_of};
use crate::arrays::{Table, pairs_of, shaped, table, thread_count};
use crate::errors::{invalid, left_domain};

/// Steps between two looks at Python's signals.
const BLOCK: usize = 1024;

type Cube<'py> = Bound<'py, PyArray3<f64>>;
/// Coordinates, rates, base and step count as Python gives them.
type GivenState<'py> = (Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>, u64);
/// Steps that every arm has made, and why it made no more.
type Ends<'py> = (Bound<'py, PyArray1<i64>>, Bound<'py, PyList>);

/// Many arms; `octoarm_env.ArmBatch` documents it.
#[pyclass(module = "octoarm_env._core")]
pub(crate) struct ArmBatch {
    inner: octoarm_env::ArmBatch,
}

/// A zeroed vector, or an error instead of an abort if there is not enough memory.
fn zeros<T: Copy>(zero: T, count: Option<usize>, steps: usize) -> PyResult<Vec<T>> {
    let refuse = || PyValueError::new_err(format!("{steps} steps: not enough memory"));
    let count = count.filter(|count| *count <= isize::MAX as usize / 16).ok_or_else(refuse)?;
    // Asked for and given back: memory that the system hands out zeroed need not be written twice.
    Vec::<T>::new().try_reserve_exact(count).map_err(|_| refuse())?;
    Ok(vec![zero; count])
}

/// Rows of an array (T, 2), the same for every arm, or (N, T, 2).
struct Rows {
    rows: Vec<[f64; 2]>,
    steps: usize,
    shared: bool,
}

impl Rows {
    fn read(name: &str, value: &Bound<'_, PyAny>, arms: usize) -> PyResult<Self> {
        let shapes = [vec![None, Some(2)], vec![Some(arms), None, Some(2)]];
        let (flat, shape) = shaped(name, value, &shapes)?;
        let shared = shape.len() == 2;
        Ok(Self { rows: pairs_of(&flat), steps: shape[shape.len() - 2], shared })
    }

    fn of(&self, arm: usize) -> &[[f64; 2]] {
        if self.shared { &self.rows } else { &self.rows[arm * self.steps..][..self.steps] }
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
    /// Runs block after block; `run` gets the steps of a block and its rows of lengths.
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
        let mut lengths = zeros(0.0, cells, steps)?;
        let mut stops: Vec<Option<Stop>> = vec![None; arms];
        let mut done = 0;
        while done < steps {
            let block = done..steps.min(done.saturating_add(BLOCK.next_multiple_of(stride)));
            let (from, to) = (block.start / stride * width, block.end / stride * width);
            let rows = if rows == 0 {
                (0..arms).map(|_| <&mut [f64]>::default()).collect()
            } else {
                lengths.chunks_exact_mut(rows * width).map(|arm| &mut arm[from..to]).collect()
            };
            let before: Vec<bool> = stops.iter().map(Option::is_some).collect();
            let (inner, stops_now) = (&mut self.inner, &mut stops);
            py.detach(|| run(inner, block.clone(), rows, stops_now));
            for (stop, before) in stops.iter_mut().zip(before) {
                // Steps are counted within a block there.
                if let Some((step, _)) = stop.as_mut().filter(|_| !before) {
                    *step += block.start;
                }
            }
            done = block.end;
            py.check_signals()?;
        }
        Ok((lengths, stops))
    }

    fn cube<'py>(&self, py: Python<'py>, flat: Vec<f64>, columns: usize) -> PyResult<Cube<'py>> {
        let rows = flat.len() / (self.inner.len() * columns);
        flat.into_pyarray(py).reshape([self.inner.len(), rows, columns])
    }

    /// A number of steps from one row of lengths to the next.
    fn stride(stride: i64) -> PyResult<usize> {
        usize::try_from(stride).ok().filter(|stride| (1..=1 << 32).contains(stride)).ok_or_else(
            || PyValueError::new_err(format!("stride = {stride}: expected 1 to {}", 1_u64 << 32)),
        )
    }
}

#[pymethods]
impl ArmBatch {
    #[new]
    fn new(py: Python<'_>, arms: Vec<PyRef<'_, Arm>>, threads: Option<i64>) -> PyResult<Self> {
        let threads = thread_count(threads)?;
        let arms: Vec<octoarm_arm::Arm> = arms.iter().map(|arm| arm.inner().clone()).collect();
        let inner = py
            .detach(|| octoarm_env::ArmBatch::new(&arms.iter().collect::<Vec<_>>(), threads))
            .map_err(invalid)?;
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
        stride: i64,
    ) -> PyResult<(Cube<'py>, Ends<'py>)> {
        let stride = Self::stride(stride)?;
        let angles = Rows::read("angles", angles, self.inner.len())?;
        for (row, command) in angles.rows.iter().enumerate() {
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
            let commands: Vec<&[[f64; 2]]> =
                (0..arms).map(|arm| &angles.of(arm)[block.clone()]).collect();
            inner.run(&commands, stride, lengths, stops);
        })?;
        let width = self.inner.observation_len();
        Ok((self.cube(py, lengths, width)?, ends(py, &stops, steps)?))
    }

    fn run_closed_loop<'py>(
        &mut self,
        py: Python<'py>,
        weights: &Bound<'py, PyAny>,
        steps: i64,
        perturbation: Option<&Bound<'py, PyAny>>,
        stride: i64,
    ) -> PyResult<(Cube<'py>, Cube<'py>, Ends<'py>)> {
        let stride = Self::stride(stride)?;
        let steps = usize::try_from(steps).map_err(|_| {
            PyValueError::new_err(format!("steps = {steps}: expected a number of steps, 0 or more"))
        })?;
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
            .map(|flat| {
                let mut weights = pairs_of(flat);
                let bias = if rows > width { weights.pop().unwrap_or_default() } else { [0.0; 2] };
                LinearReadout { weights, bias }
            })
            .collect();
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
        let mut outputs = zeros([0.0; 2], steps.checked_mul(arms), steps)?;
        let said = &mut outputs;
        let (lengths, stops) = self.blocks(py, steps, stride, |inner, block, lengths, stops| {
            let push: Option<Vec<&[[f64; 2]]>> = perturbation
                .as_ref()
                .map(|rows| (0..arms).map(|arm| &rows.of(arm)[block.clone()]).collect());
            let said = said.chunks_exact_mut(steps).map(|arm| &mut arm[block.clone()]).collect();
            inner.run_closed_loop(&readouts, push.as_deref(), stride, said, lengths, stops);
        })?;
        let outputs = self.cube(py, outputs.into_flattened(), 2)?;
        Ok((outputs, self.cube(py, lengths, width)?, ends(py, &stops, steps)?))
    }

    fn get_states<'py>(&self, py: Python<'py>) -> PyResult<Vec<State<'py>>> {
        (0..self.inner.len()).map(|arm| state_of(py, self.inner.state(arm))).collect()
    }

    fn set_states(&mut self, states: Vec<GivenState<'_>>) -> PyResult<()> {
        if states.len() != self.inner.len() {
            return Err(PyValueError::new_err(format!(
                "states has {} entries, expected {}",
                states.len(),
                self.inner.len()
            )));
        }
        let compartments = self.inner.observation_len() / 4;
        let states: Vec<ArmState> = states
            .iter()
            .map(|(coordinates, rates, base, steps)| {
                state_from(compartments, coordinates, rates, base, *steps)
            })
            .collect::<PyResult<_>>()?;
        let before: Vec<ArmState> = (0..states.len()).map(|arm| self.inner.state(arm)).collect();
        let restored =
            states.iter().enumerate().try_for_each(|(arm, state)| self.inner.set_state(arm, state));
        if let Err(error) = restored {
            for (arm, state) in before.iter().enumerate() {
                self.inner.set_state(arm, state).map_err(invalid)?;
            }
            return Err(invalid(error));
        }
        Ok(())
    }
}
