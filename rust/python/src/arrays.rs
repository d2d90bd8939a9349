//! Arrays from Python: dtype, shape and finiteness checked by name, copied once.

use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn,
    PyUntypedArray, PyUntypedArrayMethods,
};
use octoarm_arm::memory;
use pyo3::exceptions::{PyMemoryError, PyTypeError, PyValueError};
use pyo3::prelude::*;

use crate::errors::invalid;

/// A vector handed to Python.
pub(crate) type Vector<'py> = Bound<'py, PyArray1<f64>>;

/// A matrix handed to Python.
pub(crate) type Table<'py> = Bound<'py, PyArray2<f64>>;

/// Joints handed to Python, (N + 1, 4, 3).
pub(crate) type Joints<'py> = Bound<'py, PyArray3<f64>>;

/// The ends of the longitudinal springs as an array.
pub(crate) fn joints_array<'py>(
    py: Python<'py>,
    joints: Vec<[[f64; 3]; 4]>,
) -> PyResult<Joints<'py>> {
    let planes = joints.len();
    let flat = joints.into_flattened().into_flattened();
    flat.into_pyarray(py).reshape([planes, 4, 3])
}

/// Any array of real numbers as a float64 array whose numbers lie one after the other; other things
/// are a `TypeError` naming `name`.
fn as_float64<'py>(
    name: &str,
    value: &Bound<'py, PyAny>,
) -> PyResult<PyReadonlyArrayDyn<'py, f64>> {
    if let Ok(array) = value.cast_exact::<PyArrayDyn<f64>>()
        && is_dense(array)
    {
        return Ok(array.readonly());
    }
    let py = value.py();
    let numpy = py.import("numpy")?;
    let refuse = |what: String| {
        PyTypeError::new_err(format!("{name} must be an array of real numbers, not {what}"))
    };
    let array = match numpy.call_method1("asanyarray", (value,)) {
        Ok(array) => array,
        Err(error) if error.is_instance_of::<PyMemoryError>(py) => return Err(error),
        Err(_) => return Err(refuse(value.get_type().name()?.to_string())),
    };
    let dtype = array.cast::<PyUntypedArray>()?.dtype();
    let kind: String = dtype.getattr("kind")?.extract()?;
    if !matches!(kind.as_str(), "f" | "i" | "u") {
        return Err(refuse(format!("dtype {dtype}")));
    }
    // What a mask hides is not a number to go on with.
    if array.hasattr("mask")?
        && numpy.getattr("ma")?.call_method1("is_masked", (&array,))?.is_truthy()?
    {
        return Err(refuse("one with masked entries".to_owned()));
    }
    let array = if array.cast::<PyArrayDyn<f64>>().is_ok() {
        numpy.call_method1("require", (array, "float64", ["C", "A", "E"]))?
    } else {
        // Ten times as fast, and always a new array: a step's actions are of 32 bits mostly.
        array.call_method1("astype", ("float64", "C", "unsafe", false))?
    };
    Ok(array.cast::<PyArrayDyn<f64>>()?.readonly())
}

/// Whether an array's numbers lie one after the other, row by row, where numbers may lie: what is
/// strided by bytes, or begins between two numbers, cannot be read in place.
pub(crate) fn is_dense<'py>(array: &impl PyUntypedArrayMethods<'py>) -> bool {
    array.is_c_contiguous() && array.is_aligned()
}

fn shape_text(shape: &[usize]) -> String {
    let entries: Vec<String> = shape.iter().map(ToString::to_string).collect();
    match entries.as_slice() {
        [one] => format!("({one},)"),
        many => format!("({})", many.join(", ")),
    }
}

/// The numbers of an array in row-major order, and its shape, after checking that it fits
/// `expected` (None stands for any size) and that every number is finite.
pub(crate) fn numbers(
    name: &str,
    value: &Bound<'_, PyAny>,
    expected: &[Option<usize>],
) -> PyResult<(Vec<f64>, Vec<usize>)> {
    shaped(name, value, &[expected.to_vec()])
}

/// [`numbers`] of an array that fits one of several shapes.
pub(crate) fn shaped(
    name: &str,
    value: &Bound<'_, PyAny>,
    expected: &[Vec<Option<usize>>],
) -> PyResult<(Vec<f64>, Vec<usize>)> {
    let array = as_float64(name, value)?;
    let shape = array.shape().to_vec();
    let fits = |expected: &Vec<Option<usize>>| {
        shape.len() == expected.len()
            && shape
                .iter()
                .zip(expected)
                .all(|(size, wanted)| wanted.is_none_or(|wanted| wanted == *size))
    };
    if !expected.iter().any(fits) {
        let texts: Vec<String> = expected
            .iter()
            .map(|expected| {
                let wanted: Vec<String> = expected
                    .iter()
                    .map(|size| size.map_or("any".to_owned(), |size| size.to_string()))
                    .collect();
                format!("({}{})", wanted.join(", "), if wanted.len() == 1 { "," } else { "" })
            })
            .collect();
        return Err(PyValueError::new_err(format!(
            "{name} has shape {}, expected {}",
            shape_text(&shape),
            texts.join(" or ")
        )));
    }
    let given = array.as_slice()?;
    let mut numbers = memory::reserved(name, Some(given.len())).map_err(invalid)?;
    numbers.extend_from_slice(given);
    if let Some(position) = numbers.iter().position(|number| !number.is_finite()) {
        let mut rest = position;
        let mut index = vec![0; shape.len()];
        for (axis, size) in shape.iter().enumerate().rev() {
            index[axis] = rest % size;
            rest /= size;
        }
        let entries: Vec<String> = index.iter().map(ToString::to_string).collect();
        return Err(PyValueError::new_err(format!(
            "{name}[{}] = {}: all numbers must be finite",
            entries.join(", "),
            numbers[position]
        )));
    }
    Ok((numbers, shape))
}

/// Pairs of neighbouring numbers.
pub(crate) fn pairs_of(flat: &[f64]) -> &[[f64; 2]] {
    flat.as_chunks().0
}

/// A matrix of numbers in row-major order.
pub(crate) fn table(py: Python<'_>, flat: Vec<f64>, columns: usize) -> PyResult<Table<'_>> {
    let rows = flat.len() / columns;
    flat.into_pyarray(py).reshape([rows, columns])
}
