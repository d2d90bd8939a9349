//! How a request is refused.

use std::fmt::Display;

use octoarm_arm::ParameterError;
use octoarm_protocol::Status;
use tonic::Code;

/// Most characters of a message, and of a client's word in it.
const LONGEST: usize = 2000;
const LONGEST_WORD: usize = 100;

/// A client's word as it may stand in a message: in quotes, without line breaks, and not too long.
pub(crate) fn quoted(word: &str) -> String {
    let cut = word.char_indices().nth(LONGEST_WORD).map(|(place, _)| place);
    match cut {
        None => format!("{word:?}"),
        Some(place) => format!("{:?}…", &word[..place]),
    }
}

/// Why a request was refused; nothing is changed then, unless a computation failed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Refusal {
    /// What kind of error it is.
    pub(crate) code: Code,
    /// What is wrong, by name and value, and what is allowed.
    pub(crate) message: String,
}

/// What a request comes to.
pub(crate) type Answer<T> = Result<T, Refusal>;

impl Refusal {
    pub(crate) fn new(code: Code, message: impl Into<String>) -> Self {
        Self { code, message: message.into() }
    }

    /// A value that cannot be used.
    pub(crate) fn invalid(message: impl Into<String>) -> Self {
        Self::new(Code::InvalidArgument, message)
    }

    /// A value outside the range of what it is set for.
    pub(crate) fn out_of_range(name: &str, value: impl Display, range: &str) -> Self {
        Self::invalid(format!("{name} = {value} is outside the allowed range {range}"))
    }

    /// A request that does not fit where the stream stands.
    pub(crate) fn precondition(message: impl Into<String>) -> Self {
        Self::new(Code::FailedPrecondition, message)
    }

    /// More than the server gives.
    pub(crate) fn exhausted(message: impl Into<String>) -> Self {
        Self::new(Code::ResourceExhausted, message)
    }
}

impl From<ParameterError> for Refusal {
    fn from(error: ParameterError) -> Self {
        match error {
            ParameterError::Memory { .. } => Self::exhausted(error.to_string()),
            _ => Self::invalid(error.to_string()),
        }
    }
}

impl From<Refusal> for Status {
    fn from(refusal: Refusal) -> Self {
        let mut message = refusal.message;
        if let Some((place, _)) = message.char_indices().nth(LONGEST) {
            message.truncate(place);
            message.push('…');
        }
        Self { code: refusal.code as i32, message, details: Vec::new() }
    }
}
