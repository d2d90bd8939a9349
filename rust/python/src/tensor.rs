//! Tensors of the protocol, as Python and NumPy have them.

use numpy::{Element, IntoPyArray, PyArrayDyn, PyArrayMethods};
use octoarm_protocol::Tensor;
use octoarm_protocol::tensor::{
    BoolArray, DoubleArray, Int64Array, Payload, StringArray, Uint8Array, Uint64Array,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyBytes, PyFloat, PyInt, PyList, PyString};

/// A tensor of an array's elements, whatever its strides are.
fn of_array<T: Element + Copy>(
    array: &Bound<'_, PyArrayDyn<T>>,
    payload: impl FnOnce(Vec<T>) -> Payload,
) -> Tensor {
    let array = array.readonly();
    let array = array.as_array();
    let shape = array.shape().iter().map(|size| *size as i32).collect();
    Tensor { payload: Some(payload(array.iter().copied().collect())), shape }
}

fn doubles(array: &Bound<'_, PyArrayDyn<f64>>) -> Tensor {
    of_array(array, |array| Payload::Doubles(DoubleArray { array }))
}

/// Writes a number, text, bytes, or array of numbers, booleans or unsigned integers.
pub(crate) fn pack(value: &Bound<'_, PyAny>) -> PyResult<Tensor> {
    if let Ok(array) = value.cast::<PyArrayDyn<f64>>() {
        return Ok(doubles(array));
    }
    let numpy = value.py().import("numpy")?;
    if value.is_instance(&numpy.getattr("generic")?)? {
        // An integer of NumPy's is one of 64 bits too, not a double.
        return pack(&value.call_method0("item")?);
    }
    let scalar = |payload| Tensor { payload: Some(payload), shape: Vec::new() };
    Ok(if value.is_instance_of::<PyString>() {
        scalar(Payload::Strings(StringArray { array: vec![value.extract()?] }))
    } else if let Ok(bytes) = value.cast::<PyBytes>() {
        let array = bytes.as_bytes().to_vec();
        let shape = vec![array.len() as i32];
        Tensor { payload: Some(Payload::Uint8s(Uint8Array { array })), shape }
    } else if value.is_instance_of::<PyBool>() {
        scalar(Payload::Bools(BoolArray { array: vec![value.extract()?] }))
    } else if value.is_instance_of::<PyInt>() {
        scalar(if let Ok(number) = value.extract() {
            Payload::Uint64s(Uint64Array { array: vec![number] })
        } else if let Ok(number) = value.extract() {
            Payload::Int64s(Int64Array { array: vec![number] })
        } else {
            return Err(PyValueError::new_err(format!("{value}: expected an integer of 64 bits")));
        })
    } else if value.is_instance_of::<PyFloat>() {
        scalar(Payload::Doubles(DoubleArray { array: vec![value.extract()?] }))
    } else if let Ok(array) = value.cast::<PyArrayDyn<u64>>() {
        of_array(array, |array| Payload::Uint64s(Uint64Array { array }))
    } else if let Ok(array) = value.cast::<PyArrayDyn<bool>>() {
        of_array(array, |array| Payload::Bools(BoolArray { array }))
    } else {
        let array = numpy.call_method1("asarray", (value, "float64"))?;
        doubles(array.cast::<PyArrayDyn<f64>>()?)
    })
}

/// The only element of a tensor without a shape.
fn only<T>(array: Vec<T>) -> PyResult<T> {
    let count = array.len();
    let only = <[T; 1]>::try_from(array).map(|[only]| only);
    only.map_err(|_| PyValueError::new_err(format!("the server sent a scalar of {count} elements")))
}

fn wrong(kind: &str) -> PyErr {
    PyValueError::new_err(format!("the server sent {kind}"))
}

/// An array of this shape, in the memory where its elements are.
fn shaped<'py, T: Element>(
    py: Python<'py>,
    array: Vec<T>,
    shape: &[i32],
) -> PyResult<Bound<'py, PyAny>> {
    let sizes: Option<Vec<usize>> = shape.iter().map(|size| usize::try_from(*size).ok()).collect();
    let sizes = sizes.filter(|sizes| {
        sizes.iter().try_fold(1_usize, |product, size| product.checked_mul(*size))
            == Some(array.len())
    });
    let Some(sizes) = sizes else {
        return Err(wrong(&format!("{} elements for the shape {shape:?}", array.len())));
    };
    let array = array.into_pyarray(py);
    // Most of them have one dimension.
    if sizes.len() == 1 { Ok(array.into_any()) } else { Ok(array.reshape(sizes)?.into_any()) }
}

/// Reads a tensor: without a shape, a number or text; else an array of float64, int64 or bool, a list of
/// texts, or bytes.
pub(crate) fn unpack(py: Python<'_>, tensor: Tensor) -> PyResult<Bound<'_, PyAny>> {
    let Tensor { payload, shape } = tensor;
    let Some(payload) = payload else { return Err(wrong("a tensor that holds nothing")) };
    if shape.is_empty() {
        return Ok(match payload {
            Payload::Doubles(list) => PyFloat::new(py, only(list.array)?).into_any(),
            Payload::Int64s(list) => only(list.array)?.into_pyobject(py)?.into_any(),
            Payload::Uint64s(list) => only(list.array)?.into_pyobject(py)?.into_any(),
            Payload::Bools(list) => PyBool::new(py, only(list.array)?).to_owned().into_any(),
            Payload::Strings(list) => PyString::new(py, &only(list.array)?).into_any(),
            _ => return Err(wrong("a scalar of another kind")),
        });
    }
    match payload {
        Payload::Doubles(list) => shaped(py, list.array, &shape),
        Payload::Bools(list) => shaped(py, list.array, &shape),
        Payload::Int64s(list) => shaped(py, list.array, &shape),
        Payload::Strings(list) => Ok(PyList::new(py, list.array)?.into_any()),
        Payload::Uint8s(list) => Ok(PyBytes::new(py, &list.array).into_any()),
        _ => Err(wrong("an array of another kind")),
    }
}
