//! The infos of many episodes, as Gymnasium joins them.

use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods};
use octoarm_env::{BatchStep, DisturbanceInfo, Last, Outcome, ReachOutcome, Reading, Told};
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::table;

pub(crate) type Infos<'py> = Bound<'py, PyDict>;

/// The keys of an info, and how each is read.
pub(crate) type Words<O> = Vec<(&'static str, Reading<O>)>;

/// What tells of disturbances.
pub(crate) trait Disturbed {
    fn disturbance(&self) -> Option<&DisturbanceInfo>;
}

impl Disturbed for Outcome {
    fn disturbance(&self) -> Option<&DisturbanceInfo> {
        self.disturbance.as_deref()
    }
}

impl Disturbed for ReachOutcome {
    fn disturbance(&self) -> Option<&DisturbanceInfo> {
        self.disturbance.as_deref()
    }
}

/// The parts of the disturbances of episodes with the same settings: an array each, of a row for each
/// episode, zeros for those without.
fn set_disturbances<O: Disturbed>(infos: &Infos<'_>, outcomes: &[Option<&O>]) -> PyResult<()> {
    let py = infos.py();
    let told: Vec<_> =
        outcomes.iter().map(|outcome| outcome.and_then(Disturbed::disturbance)).collect();
    let mask: Vec<bool> = told.iter().map(Option::is_some).collect();
    let Some(first) = told.iter().flatten().next() else { return Ok(()) };
    for (name, read) in DisturbanceInfo::PARTS {
        let parts = told.iter().map(|told| told.and_then(read));
        match read(first) {
            None => continue,
            Some(Told::Numbers(numbers)) => {
                let rows = parts.map(|part| match part {
                    Some(Told::Numbers(numbers)) => Some(numbers),
                    _ => None,
                });
                infos.set_item(name, rows_of(py, rows, numbers.len())?)?;
            }
            Some(Told::Flags(flags)) => {
                let rows = parts.map(|part| match part {
                    Some(Told::Flags(flags)) => Some(flags),
                    _ => None,
                });
                infos.set_item(name, rows_of(py, rows, flags.len())?)?;
            }
            Some(Told::Count(_)) => {
                let counts = parts.map(|part| match part {
                    Some(Told::Count(count)) => count as i64,
                    _ => 0,
                });
                infos.set_item(name, counts.collect::<Vec<i64>>().into_pyarray(py))?;
            }
        }
        set_mask(infos, name, &mask)?;
    }
    Ok(())
}

/// Rows of this width below each other, zeros for those that are missing.
fn rows_of<'py, 'a, T: numpy::Element + Copy + Default + 'a>(
    py: Python<'py>,
    rows: impl Iterator<Item = Option<&'a [T]>>,
    width: usize,
) -> PyResult<Bound<'py, PyArray2<T>>> {
    let mut values = Vec::new();
    let mut count = 0;
    for row in rows {
        count += 1;
        match row {
            Some(row) => values.extend_from_slice(row),
            None => values.resize(count * width, T::default()),
        }
    }
    values.into_pyarray(py).reshape([count, width])
}

/// A row of flags, and the name of the key that it belongs to.
fn set_mask(infos: &Infos<'_>, key: &str, mask: &[bool]) -> PyResult<()> {
    infos.set_item(format!("_{key}"), PyArray1::from_slice(infos.py(), mask))
}

/// The infos of the environments that have one, as `gymnasium.vector.VectorEnv` joins them: an array
/// a key, zeros for the others, and a mask.
pub(crate) fn infos<'py, O: Disturbed>(
    py: Python<'py>,
    words: Words<O>,
    outcomes: &[Option<&O>],
) -> PyResult<Infos<'py>> {
    let infos = PyDict::new(py);
    let mask: Vec<bool> = outcomes.iter().map(Option::is_some).collect();
    if !mask.contains(&true) {
        return Ok(infos);
    }
    for (name, reading) in words {
        let some = || outcomes.iter().copied();
        match reading {
            Reading::Number(read) => {
                let values: Vec<f64> = some().map(|outcome| outcome.map_or(0.0, read)).collect();
                infos.set_item(name, values.into_pyarray(py))?;
            }
            Reading::Angles(read) => {
                let values = some().flat_map(|outcome| outcome.map_or([0.0; 2], read)).collect();
                infos.set_item(name, table(py, values, 2)?)?;
            }
            Reading::Point(read) => {
                let values = some().flat_map(|outcome| outcome.map_or([0.0; 3], read)).collect();
                infos.set_item(name, table(py, values, 3)?)?;
            }
            Reading::Index(read) => {
                let index = |outcome| read(outcome) as i64;
                let values: Vec<i64> = some().map(|outcome| outcome.map_or(0, index)).collect();
                infos.set_item(name, values.into_pyarray(py))?;
            }
            Reading::Flag(read) => {
                let values: Vec<bool> = some().map(|outcome| outcome.is_some_and(read)).collect();
                infos.set_item(name, values.into_pyarray(py))?;
            }
            Reading::Text(read) => {
                let texts: Vec<Option<String>> = some().map(|outcome| read(outcome?)).collect();
                let mask: Vec<bool> = texts.iter().map(Option::is_some).collect();
                if mask.contains(&true) {
                    infos.set_item(name, objects(py, texts)?)?;
                    set_mask(&infos, name, &mask)?;
                }
                continue;
            }
        }
        set_mask(&infos, name, &mask)?;
    }
    set_disturbances(&infos, outcomes)?;
    Ok(infos)
}

/// A NumPy array of Python objects.
fn objects<'py, T: IntoPyObject<'py>>(
    py: Python<'py>,
    values: Vec<Option<T>>,
) -> PyResult<Bound<'py, PyAny>> {
    let arguments = PyDict::new(py);
    arguments.set_item("dtype", "object")?;
    let array = py.import("numpy")?.call_method("empty", (values.len(),), Some(&arguments))?;
    for (index, value) in values.into_iter().enumerate() {
        if let Some(value) = value {
            array.set_item(index, value)?;
        }
    }
    Ok(array)
}

/// The infos of a step; those of episodes that ended and began anew within it are under `final_info`.
/// What an agent saw last is made into its observation by `observe`.
pub(crate) fn step_infos<'py, O: Disturbed, T: IntoPyObject<'py>>(
    py: Python<'py>,
    words: impl Fn() -> Words<O>,
    step: &mut BatchStep<O>,
    observe: impl Fn(Last<O>) -> PyResult<T>,
) -> PyResult<Infos<'py>> {
    let outcomes: Vec<Option<&O>> = step.outcomes.iter().map(Some).collect();
    let infos = infos(py, words(), &outcomes)?;
    let mask: Vec<bool> = step.lasts.iter().map(Option::is_some).collect();
    if mask.contains(&true) {
        let ends: Vec<Option<&O>> =
            step.lasts.iter().map(|last| last.as_ref().map(|last| &last.outcome)).collect();
        infos.set_item(intern!(py, "final_info"), self::infos(py, words(), &ends)?)?;
        set_mask(&infos, "final_info", &mask)?;
        let observations: Vec<Option<T>> = std::mem::take(&mut step.lasts)
            .into_iter()
            .map(|last| last.map(&observe).transpose())
            .collect::<PyResult<_>>()?;
        infos.set_item(intern!(py, "final_obs"), objects(py, observations)?)?;
        set_mask(&infos, "final_obs", &mask)?;
    }
    Ok(infos)
}
