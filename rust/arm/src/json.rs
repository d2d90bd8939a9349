//! Reading JSON text that a user or another program wrote.

use crate::error::ParameterError;

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
