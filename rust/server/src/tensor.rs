//! Tensors from the wire, checked; and tensors for the wire.

use octoarm_protocol::tensor::{
    BoolArray, DoubleArray, Int64Array, Payload, StringArray, Uint8Array, Uint64Array,
};
use octoarm_protocol::{DataType, Tensor};
use serde_json::Value;

use crate::reply::{Answer, Refusal};

/// Most dimensions: no tensor of the arm has more than three.
const MOST_DIMENSIONS: usize = 4;
/// Most elements of any tensor.
const MOST_ELEMENTS: usize = 1 << 20;
/// Most elements of a setting that a single one may stand for.
const MOST_FILLED: usize = 16;
/// Largest integer up to which every one is a double.
const EXACT_INTEGER: f64 = 9_007_199_254_740_992.0;

/// A tensor of doubles.
pub(crate) fn doubles(array: Vec<f64>, shape: &[i32]) -> Tensor {
    Tensor { payload: Some(Payload::Doubles(DoubleArray { array })), shape: shape.to_vec() }
}

/// A tensor of flags.
pub(crate) fn bools(array: Vec<bool>, shape: &[i32]) -> Tensor {
    Tensor { payload: Some(Payload::Bools(BoolArray { array })), shape: shape.to_vec() }
}

/// A tensor of texts.
pub(crate) fn strings(array: Vec<String>, shape: &[i32]) -> Tensor {
    Tensor { payload: Some(Payload::Strings(StringArray { array })), shape: shape.to_vec() }
}

/// A row of bytes.
pub(crate) fn bytes(array: Vec<u8>) -> Tensor {
    let shape = vec![array.len() as i32];
    Tensor { payload: Some(Payload::Uint8s(Uint8Array { array })), shape }
}

/// One integer.
pub(crate) fn integer(value: i64) -> Tensor {
    Tensor { payload: Some(Payload::Int64s(Int64Array { array: vec![value] })), shape: Vec::new() }
}

/// Counts, in so many rows.
pub(crate) fn integers(values: impl Iterator<Item = usize>, shape: &[i32]) -> Tensor {
    let array = values.map(|value| value as i64).collect();
    Tensor { payload: Some(Payload::Int64s(Int64Array { array })), shape: shape.to_vec() }
}

/// One integer that is not negative.
pub(crate) fn unsigned(value: u64) -> Tensor {
    Tensor {
        payload: Some(Payload::Uint64s(Uint64Array { array: vec![value] })),
        shape: Vec::new(),
    }
}

/// One text.
pub(crate) fn text(value: impl Into<String>) -> Tensor {
    strings(vec![value.into()], &[])
}

/// The type of a tensor's elements.
pub(crate) fn data_type(tensor: &Tensor) -> DataType {
    match tensor.payload {
        None => DataType::InvalidDataType,
        Some(Payload::Floats(_)) => DataType::Float,
        Some(Payload::Doubles(_)) => DataType::Double,
        Some(Payload::Int8s(_)) => DataType::Int8,
        Some(Payload::Int32s(_)) => DataType::Int32,
        Some(Payload::Int64s(_)) => DataType::Int64,
        Some(Payload::Uint8s(_)) => DataType::Uint8,
        Some(Payload::Uint32s(_)) => DataType::Uint32,
        Some(Payload::Uint64s(_)) => DataType::Uint64,
        Some(Payload::Bools(_)) => DataType::Bool,
        Some(Payload::Strings(_)) => DataType::String,
        Some(Payload::Protos(_)) => DataType::Proto,
    }
}

/// The sizes that a shape stands for, given the number of elements; a single element fills any shape,
/// and a negative size is found from the others.
fn resolve(name: &str, shape: &[i32], elements: usize) -> Answer<Vec<usize>> {
    if shape.len() > MOST_DIMENSIONS {
        return Err(Refusal::invalid(format!(
            "{name} has {} dimensions, at most {MOST_DIMENSIONS} are allowed",
            shape.len()
        )));
    }
    let refuse = |why: &str| {
        Err(Refusal::invalid(format!("{name} has shape {shape:?} and {elements} elements: {why}")))
    };
    let open = shape.iter().filter(|size| **size < 0).count();
    if open > 1 {
        return refuse("at most one size may be negative");
    }
    let known = shape
        .iter()
        .filter(|size| **size >= 0)
        .try_fold(1_usize, |product, size| product.checked_mul(*size as usize));
    let Some(known) = known.filter(|known| *known <= MOST_ELEMENTS) else {
        return refuse(&format!("at most {MOST_ELEMENTS} elements are allowed"));
    };
    let free = match (open, elements) {
        (0, _) => 0,
        (_, 1) => 1,
        _ if known > 0 && elements.is_multiple_of(known) => elements / known,
        _ => return refuse("the elements do not fill it"),
    };
    let sizes: Vec<usize> =
        shape.iter().map(|size| usize::try_from(*size).unwrap_or(free)).collect();
    let total: usize = sizes.iter().product();
    if elements == 1 || elements == total {
        Ok(sizes)
    } else {
        refuse("the elements do not fill it")
    }
}

/// The doubles of a tensor that must have the given shape (or one that stands for it), every element
/// written out.
pub(crate) fn doubles_of(name: &str, tensor: &Tensor, shape: &[i32]) -> Answer<Vec<f64>> {
    let Some(Payload::Doubles(DoubleArray { array })) = &tensor.payload else {
        return Err(Refusal::invalid(format!(
            "{name} has elements of type {}, expected {}",
            data_type(tensor).as_str_name(),
            DataType::Double.as_str_name()
        )));
    };
    let wanted: Vec<usize> = shape.iter().map(|size| *size as usize).collect();
    let total: usize = wanted.iter().product();
    let mut given = tensor.shape.clone();
    if given.len() == shape.len() && array.len() == 1 {
        // A single element fills the open size too.
        if given.iter().filter(|size| **size < 0).count() == 1 {
            for (size, wanted) in given.iter_mut().zip(shape) {
                if *size < 0 {
                    *size = *wanted;
                }
            }
        }
    }
    if resolve(name, &given, array.len())? != wanted {
        return Err(Refusal::invalid(format!(
            "{name} has shape {:?}, expected {shape:?}",
            tensor.shape
        )));
    }
    Ok(if array.len() == total { array.clone() } else { vec![array[0]; total] })
}

fn number(name: &str, value: f64) -> Answer<Value> {
    // Languages with one type of number send whole ones as doubles.
    if value.fract() == 0.0
        && value.abs() <= EXACT_INTEGER
        && (value != 0.0 || value.is_sign_positive())
    {
        return Ok(Value::from(value as i64));
    }
    serde_json::Number::from_f64(value)
        .map(Value::Number)
        .ok_or_else(|| Refusal::invalid(format!("{name} = {value}: expected a finite number")))
}

fn nest(mut flat: Vec<Value>, sizes: &[usize]) -> Value {
    for size in sizes.iter().skip(1).rev() {
        let mut rows = Vec::new();
        let mut rest = flat.into_iter();
        loop {
            let row: Vec<Value> = rest.by_ref().take(*size).collect();
            if row.is_empty() {
                break;
            }
            rows.push(Value::Array(row));
        }
        flat = rows;
    }
    Value::Array(flat)
}

/// Number of elements that were sent.
fn elements(payload: &Payload) -> usize {
    match payload {
        Payload::Floats(list) => list.array.len(),
        Payload::Doubles(list) => list.array.len(),
        Payload::Int8s(list) => list.array.len(),
        Payload::Int32s(list) => list.array.len(),
        Payload::Int64s(list) => list.array.len(),
        Payload::Uint8s(list) => list.array.len(),
        Payload::Uint32s(list) => list.array.len(),
        Payload::Uint64s(list) => list.array.len(),
        Payload::Bools(list) => list.array.len(),
        Payload::Strings(list) => list.array.len(),
        Payload::Protos(list) => list.array.len(),
    }
}

/// A setting as JSON: a value, or nested lists of at most `most` of them.
pub(crate) fn to_json(name: &str, tensor: &Tensor, most: usize) -> Answer<Value> {
    let Some(payload) = &tensor.payload else {
        return Err(Refusal::invalid(format!("{name} holds nothing")));
    };
    // All of this is known before anything is built.
    let sent = elements(payload);
    let sizes = resolve(name, &tensor.shape, sent)?;
    let total: usize = sizes.iter().product();
    let most = if sent == total { most } else { most.min(MOST_FILLED) };
    if total > most {
        return Err(Refusal::invalid(format!(
            "{name} stands for {total} elements, at most {most} are allowed here"
        )));
    }
    let flat: Vec<Value> = match payload {
        Payload::Floats(list) => {
            list.array.iter().map(|value| number(name, f64::from(*value))).collect::<Answer<_>>()?
        }
        Payload::Doubles(list) => {
            list.array.iter().map(|value| number(name, *value)).collect::<Answer<_>>()?
        }
        Payload::Int8s(list) => list.array.iter().map(|value| Value::from(*value as i8)).collect(),
        Payload::Uint8s(list) => list.array.iter().map(|value| Value::from(*value)).collect(),
        Payload::Int32s(list) => list.array.iter().map(|value| Value::from(*value)).collect(),
        Payload::Int64s(list) => list.array.iter().map(|value| Value::from(*value)).collect(),
        Payload::Uint32s(list) => list.array.iter().map(|value| Value::from(*value)).collect(),
        Payload::Uint64s(list) => list.array.iter().map(|value| Value::from(*value)).collect(),
        Payload::Bools(list) => list.array.iter().map(|value| Value::from(*value)).collect(),
        Payload::Strings(list) if sent == total => {
            list.array.iter().map(|value| Value::from(value.as_str())).collect()
        }
        Payload::Strings(_) => {
            return Err(Refusal::invalid(format!("{name}: one text does not fill a shape")));
        }
        Payload::Protos(_) => {
            return Err(Refusal::invalid(format!(
                "{name} holds messages, expected numbers or a text"
            )));
        }
    };
    if sizes.is_empty() {
        return flat.into_iter().next().ok_or_else(|| Refusal::invalid(format!("{name} is empty")));
    }
    let flat = if flat.len() == total { flat } else { vec![flat[0].clone(); total] };
    Ok(if total == 0 { Value::Array(Vec::new()) } else { nest(flat, &sizes) })
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn refused(result: Answer<impl std::fmt::Debug>) -> String {
        result.expect_err("refused").message
    }

    #[test]
    fn a_double_fills_open_and_whole_shapes() {
        let two = |array: &[f64], shape: &[i32]| {
            doubles_of("action", &doubles(array.to_vec(), shape), &[2])
        };
        assert_eq!(two(&[0.5, -0.5], &[2]), Ok(vec![0.5, -0.5]));
        assert_eq!(two(&[0.5, -0.5], &[-1]), Ok(vec![0.5, -0.5]));
        assert_eq!(two(&[0.5], &[2]), Ok(vec![0.5, 0.5]));
        assert_eq!(two(&[0.5], &[-1]), Ok(vec![0.5, 0.5]));
        for (array, shape) in [
            (&[0.5][..], &[][..]),
            (&[0.5], &[1]),
            (&[0.5], &[2, 1]),
            (&[0.5], &[i32::MAX]),
            (&[], &[2]),
            (&[0.5, 0.5, 0.5], &[2]),
            (&[0.5, 0.5, 0.5], &[-1]),
            (&[0.5, 0.5], &[-1, -1]),
        ] {
            let message = refused(two(array, shape));
            assert!(message.starts_with("action has shape"), "{message}");
        }
        let rows = doubles_of("action", &doubles(vec![1.0; 6], &[-1, 2]), &[3, 2]);
        assert_eq!(rows.map(|rows| rows.len()), Ok(6));
        let message = refused(doubles_of("action", &doubles(vec![1.0; 4], &[-1, -1]), &[2, 2]));
        assert!(message.contains("at most one size"), "{message}");
        let message = refused(doubles_of("action", &integer(1), &[2]));
        assert_eq!(message, "action has elements of type INT64, expected DOUBLE");
    }

    #[test]
    fn settings_become_json() {
        let json = |tensor: &Tensor| to_json("it", tensor, 100).expect("json");
        assert_eq!(json(&text("lissajous")), json!("lissajous"));
        assert_eq!(json(&integer(-3)), json!(-3));
        assert_eq!(json(&doubles(vec![20.0], &[])), json!(20));
        assert_eq!(json(&doubles(vec![0.1], &[])), json!(0.1));
        assert_eq!(
            json(&doubles(vec![0.5, 1.5, 2.5, 3.5], &[-1, 2])),
            json!([[0.5, 1.5], [2.5, 3.5]])
        );
        assert_eq!(json(&doubles(vec![0.5], &[2, 2])), json!([[0.5, 0.5], [0.5, 0.5]]));
        assert_eq!(json(&doubles(vec![], &[0])), json!([]));
        assert!(refused(to_json("it", &doubles(vec![f64::NAN], &[]), 1)).contains("it = NaN"));
        assert!(
            refused(to_json("it", &doubles(vec![1.5], &[i32::MAX, 4]), 100)).contains("at most")
        );
        assert!(refused(to_json("it", &doubles(vec![], &[]), 1)).contains("do not fill"));
        assert!(refused(to_json("it", &Tensor::default(), 1)).contains("holds nothing"));
        let long = strings(vec!["x".repeat(16_000)], &[1 << 20]);
        assert!(refused(to_json("it", &long, 1 << 20)).contains("at most 16"));
        assert!(
            refused(to_json("it", &strings(vec!["x".to_owned()], &[3]), 9)).contains("one text")
        );
        let filled = doubles(vec![0.5], &[1 << 19, 2]);
        assert!(refused(to_json("it", &filled, 1 << 20)).contains("at most 16"));
        let deep = Tensor { shape: vec![1; 100_000], ..doubles(vec![0.5], &[]) };
        assert!(refused(to_json("it", &deep, 1)).contains("100000 dimensions"));
        assert!(refused(doubles_of("it", &deep, &[2])).contains("100000 dimensions"));
        assert!(refused(to_json("it", &doubles(vec![0.5; 20], &[20]), 16)).contains("20 elements"));
    }
}
