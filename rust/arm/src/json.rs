//! Reading JSON that a user or another program wrote.

use serde::de::{DeserializeOwned, Deserializer};

use crate::error::ParameterError;

/// Reads JSON text; what is wrong with it is said with the name of the field.
///
/// # Errors
/// [`ParameterError::Format`].
pub fn read_json<T: DeserializeOwned>(text: &str) -> Result<T, ParameterError> {
    let mut reader = serde_json::Deserializer::from_str(text);
    let value = read_fields(&mut reader)?;
    reader.end().map_err(|error| ParameterError::Format(error.to_string()))?;
    Ok(value)
}

/// Reads what any format of serde holds, as [`read_json`] does for JSON text.
///
/// # Errors
/// [`ParameterError::Format`].
pub fn read_fields<'de, T: DeserializeOwned, D: Deserializer<'de>>(
    from: D,
) -> Result<T, ParameterError> {
    serde_path_to_error::deserialize(from).map_err(|error| {
        let path = error.path().to_string();
        let reason = error.into_inner().to_string();
        // The text is mostly made by a program: its line and column say nothing to its user.
        let reason = reason.split(" at line ").next().unwrap_or_default().to_owned();
        ParameterError::Format(if path == "." { reason } else { format!("{path}: {reason}") })
    })
}
