//! Arrays from Python: dtype, shape and finiteness checked by name, copied once.

use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn,
    PyUntypedArray, PyUntypedArrayMethods,
};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;

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

/// Any array of real numbers as a float64 array; other things are a `TypeError` naming `name`.
fn as_float64<'py>(
    name: &str,
    value: &Bound<'py, PyAny>,
) -> PyResult<PyReadonlyArrayDyn<'py, f64>> {
    if let Ok(array) = value.cast::<PyArrayDyn<f64>>() {
        return Ok(array.readonly());
    }
    let numpy = value.py().import("numpy")?;
    let refuse = |what: String| {
        PyTypeError::new_err(format!("{name} must be an array of real numbers, not {what}"))
    };
    let Ok(array) = numpy.call_method1("asarray", (value,)) else {
        return Err(refuse(value.get_type().name()?.to_string()));
    };
    let dtype = array.cast::<PyUntypedArray>()?.dtype();
    let kind: String = dtype.getattr("kind")?.extract()?;
    if !matches!(kind.as_str(), "f" | "i" | "u") {
        return Err(refuse(format!("dtype {dtype}")));
    }
    let arguments = PyDict::new(value.py());
    arguments.set_item("dtype", "float64")?;
    let array = numpy.call_method("asarray", (array,), Some(&arguments))?;
    Ok(array.cast::<PyArrayDyn<f64>>()?.readonly())
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
    let numbers: Vec<f64> = array.as_array().iter().copied().collect();
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
pub(crate) fn pairs_of(flat: &[f64]) -> Vec<[f64; 2]> {
    flat.chunks_exact(2).map(|pair| [pair[0], pair[1]]).collect()
}

/// Rows of a (T, 2) array.
pub(crate) fn pairs(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Vec<[f64; 2]>> {
    let (flat, _) = numbers(name, value, &[None, Some(2)])?;
    Ok(pairs_of(&flat))
}

/// A matrix of numbers in row-major order.
pub(crate) fn table(py: Python<'_>, flat: Vec<f64>, columns: usize) -> PyResult<Table<'_>> {
    let rows = flat.len() / columns;
    flat.into_pyarray(py).reshape([rows, columns])
}

/// A number of threads; what is not positive is refused by name.
pub(crate) fn thread_count(threads: Option<i64>) -> PyResult<Option<usize>> {
    // Whatever is negative is refused as 0 is, with its own value in the message.
    threads
        .map(|threads| {
            usize::try_from(threads).map_err(|_| {
                PyValueError::new_err(format!("threads = {threads}: expected a positive number"))
            })
        })
        .transpose()
}
