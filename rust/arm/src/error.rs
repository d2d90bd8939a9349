//! Arguments that cannot be used, in words that name the argument, its value and what is allowed.

use std::fmt::Display;

use thiserror::Error;

/// A parameter, file or argument that cannot be used.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum ParameterError {
    /// A value lies outside its range.
    #[error("{name} = {value} is outside the allowed range {range}")]
    OutOfRange {
        /// Name of the field or argument.
        name: String,
        /// The value that was given.
        value: String,
        /// The allowed range, as an interval or in words.
        range: String,
    },
    /// A number is infinite or NaN.
    #[error("{name} = {value} is not a finite number")]
    NotFinite {
        /// Name of the entry.
        name: String,
        /// The value that was given.
        value: f64,
    },
    /// A step was asked of an episode that was never reset or is over.
    #[error("{name}: no episode runs before reset or after its end; call reset first")]
    NotRunning {
        /// What was asked for.
        name: String,
    },
    /// An array has the wrong shape.
    #[error("{name} has shape {found}, expected {expected}")]
    Shape {
        /// Name of the argument.
        name: String,
        /// The shape that was given.
        found: String,
        /// The shape that is needed.
        expected: String,
    },
    /// A text cannot be read; it is told which field is wrong, and why.
    #[error("{0}")]
    Format(String),
    /// The computation needs more memory than there is.
    #[error("{what}: not enough memory{}", bytes.map_or(String::new(), |bytes| format!(" for {bytes} bytes")))]
    Memory {
        /// What the memory was for, with the argument that sets its amount.
        what: String,
        /// Number of bytes; none if the number itself overflows.
        bytes: Option<usize>,
    },
    /// The computation was told to stop, see [`crate::interruptible`].
    #[error("interrupted")]
    Interrupted,
    /// The body has no static equilibrium that can be found.
    #[error(
        "no static equilibrium found: {reason}; lower gravity or arm_density, raise \
         longitudinal_stiffness, or start undeformed"
    )]
    NoEquilibrium {
        /// What the search ran into.
        reason: String,
    },
}

impl ParameterError {
    /// An [`OutOfRange`](Self::OutOfRange) of a name, a value and the allowed range.
    pub fn out_of_range(name: impl Into<String>, value: impl Display, range: impl Display) -> Self {
        Self::OutOfRange { name: name.into(), value: value.to_string(), range: range.to_string() }
    }

    /// A [`Shape`](Self::Shape) of a name, the shape that was given and the one that is needed.
    pub fn shape(name: impl Into<String>, found: impl Display, expected: impl Display) -> Self {
        let (found, expected) = (found.to_string(), expected.to_string());
        Self::Shape { name: name.into(), found, expected }
    }
}

/// Refuses a number that is infinite or NaN; `name` is asked only then.
///
/// # Errors
/// [`ParameterError::NotFinite`].
pub fn check_finite(value: f64, name: impl FnOnce() -> String) -> Result<(), ParameterError> {
    if value.is_finite() { Ok(()) } else { Err(ParameterError::NotFinite { name: name(), value }) }
}
