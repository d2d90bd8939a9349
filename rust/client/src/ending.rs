//! How a stream ended.

use std::error::Error;

use tonic::{Code, Status};

/// How a stream ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Ending {
    /// The name of gRPC's code, such as `RESOURCE_EXHAUSTED`; `OK` if nothing is wrong.
    pub code: String,
    /// What is told of it.
    pub details: String,
    /// Whether it was the connection that ended, and not the server that ended the stream.
    pub(crate) broken: bool,
}

/// A code as gRPC's documents write it.
fn name(code: Code) -> String {
    let mut name = String::new();
    for (place, letter) in format!("{code:?}").char_indices() {
        if place > 0 && letter.is_uppercase() {
            name.push('_');
        }
        name.push(letter.to_ascii_uppercase());
    }
    name
}

/// An error and its causes, each told once.
fn whole(error: &dyn Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        let more = error.to_string();
        if !text.contains(&more) {
            text = format!("{text}: {more}");
        }
        cause = error.source();
    }
    text
}

impl Ending {
    pub(crate) fn over() -> Self {
        Self { code: name(Code::Ok), details: String::new(), broken: false }
    }

    pub(crate) fn forked() -> Self {
        let details = "it was opened by the process that this one was forked from".to_owned();
        Self { code: name(Code::FailedPrecondition), details, broken: true }
    }

    pub(crate) fn of_transport(error: impl Error) -> Self {
        Self { code: name(Code::Unavailable), details: whole(&error), broken: true }
    }
}

impl From<Status> for Ending {
    fn from(status: Status) -> Self {
        match status.source() {
            // A server's own words have no cause here.
            None => Self {
                code: name(status.code()),
                details: status.message().to_owned(),
                broken: false,
            },
            Some(_) => {
                Self { code: name(Code::Unavailable), details: whole(&status), broken: true }
            }
        }
    }
}
