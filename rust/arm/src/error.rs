//! What can go wrong, in words that name the quantity, its value and its limit.

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

/// Reads JSON text; what is wrong with it is said with the name of the field.
///
/// # Errors
/// [`ParameterError::Format`].
pub fn read_json<T: serde::de::DeserializeOwned>(text: &str) -> Result<T, ParameterError> {
    let mut reader = serde_json::Deserializer::from_str(text);
    let value = serde_path_to_error::deserialize(&mut reader).map_err(|error| {
        let path = error.path().to_string();
        let reason = error.into_inner().to_string();
        // The text is mostly made by a program: its line and column say nothing to its user.
        let reason = reason.split(" at line ").next().unwrap_or_default().to_owned();
        ParameterError::Format(if path == "." { reason } else { format!("{path}: {reason}") })
    })?;
    reader.end().map_err(|error| ParameterError::Format(error.to_string()))?;
    Ok(value)
}

/// The limits within which the model speaks of a soft arm, see [`crate::domain`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Limit {
    /// A universal joint's angle |α| or |β| \[rad\].
    BendAngle,
    /// A strut's height relative to its rest height.
    Height,
    /// A radius relative to its rest value.
    Radius,
    /// A longitudinal spring's length relative to its rest length.
    SpringLength,
    /// A coordinate or rate that is not a finite number.
    NotFinite,
}

impl Limit {
    /// The limit's name as it appears in messages and in `info["failure"]`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::BendAngle => "bend_angle",
            Self::Height => "height",
            Self::Radius => "radius",
            Self::SpringLength => "spring_length",
            Self::NotFinite => "not_finite",
        }
    }
}

/// The arm has left the domain in which the model describes it. The arm keeps its last valid state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DomainError {
    /// Which limit was passed.
    pub limit: Limit,
    /// The compartment, counted from 1 at the base.
    pub compartment: usize,
    /// The value found (relative to rest, or radians for the bend angle).
    pub value: f64,
    /// The lower limit.
    pub low: f64,
    /// The upper limit.
    pub high: f64,
    /// Time since the last reset at which the failing step would have ended \[s\].
    pub time: f64,
}

impl std::fmt::Display for DomainError {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { limit, compartment, value, low, high, time } = self;
        write!(formatter, "the arm left its domain: ")?;
        match limit {
            Limit::NotFinite => {
                write!(formatter, "compartment {compartment} has no finite state")?;
            }
            _ => write!(
                formatter,
                "{} of compartment {compartment} is {value:.4}, allowed {low:.4} to {high:.4}",
                limit.name()
            )?,
        }
        write!(formatter, ", at t = {time:.4} s")
    }
}

impl std::error::Error for DomainError {}
