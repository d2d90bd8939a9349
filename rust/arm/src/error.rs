//! Arguments that cannot be used, in words that name the argument, its value and what is allowed.

use thiserror::Error;

/// A parameter, file or argument that cannot be used.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum ParameterError {
    /// A value outside its range.
    #[error("{name} = {value} is outside the allowed range {range}")]
    OutOfRange {
        /// The field's or argument's name.
        name: String,
        /// The offending value.
        value: String,
        /// The allowed range, in words or as an interval.
        range: String,
    },
    /// An array of the wrong shape.
    #[error("{name} has shape {found}, expected {expected}")]
    Shape {
        /// The argument's name.
        name: String,
        /// The shape that was given.
        found: String,
        /// The shape that is needed.
        expected: String,
    },
    /// Text that cannot be read: which field, and why.
    #[error("{0}")]
    Format(String),
    /// More memory than there is.
    #[error("{what}: not enough memory{}", bytes.map_or(String::new(), |bytes| format!(" for {bytes} bytes")))]
    Memory {
        /// What the memory was for, with the argument that sets its amount.
        what: String,
        /// How much; none if the number itself overflows.
        bytes: Option<usize>,
    },
    /// The computation was told to stop, see [`crate::interruptible`].
    #[error("interrupted")]
    Interrupted,
    /// No static equilibrium was found for the body.
    #[error(
        "no static equilibrium found: {reason}; lower gravity or arm_density, raise \
         longitudinal_stiffness, or start undeformed"
    )]
    NoEquilibrium {
        /// What the search ran into.
        reason: String,
    },
}
