//! Memory whose amount a caller sets: asked for first, so that too much is an error and no abort.

use crate::error::ParameterError;

/// Whether `count` items of `T` for `what` fit into memory now.
///
/// # Errors
/// [`ParameterError::Memory`] if they do not; `None`, an overflow, never does.
pub fn check_room<T>(what: &str, count: Option<usize>) -> Result<(), ParameterError> {
    reserved::<T>(what, count).map(|_| ())
}

/// A vector of `count` copies of `value`.
///
/// # Errors
/// As [`check_room`].
pub fn filled<T: Clone>(
    what: &str,
    value: T,
    count: Option<usize>,
) -> Result<Vec<T>, ParameterError> {
    check_room::<T>(what, count)?;
    // Asked for and given back: memory that the system hands out zeroed need not be written twice.
    Ok(vec![value; count.unwrap_or_default()])
}

/// An empty vector with room for `count` items.
///
/// # Errors
/// As [`check_room`].
pub fn reserved<T>(what: &str, count: Option<usize>) -> Result<Vec<T>, ParameterError> {
    let mut vector = Vec::new();
    match count.map(|count| vector.try_reserve_exact(count)) {
        Some(Ok(())) => Ok(vector),
        _ => Err(ParameterError::Memory {
            what: what.to_owned(),
            bytes: count.and_then(|count| count.checked_mul(size_of::<T>())),
        }),
    }
}
