//! States of episodes on the wire: JSON text for eyes, MessagePack where they are many or often.

use octoarm_arm::{ParameterError, read_fields, read_json};
use octoarm_protocol::Tensor;
use octoarm_protocol::tensor::{Payload, StringArray, Uint8Array};
use serde::Serialize;
use serde::de::DeserializeOwned;
use tonic::Code;

use crate::environment::Environment;
use crate::episodes::Episodes;
use crate::reply::{Answer, Refusal};
use crate::tensor;

/// How a state is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Form {
    /// JSON, a text.
    Text,
    /// MessagePack of the same fields, an array of bytes; every number is exact.
    Bytes,
}

fn write<T: Serialize>(state: &T, form: Form) -> Answer<Tensor> {
    let failed = |error: String| Refusal::new(Code::Internal, error);
    match form {
        Form::Text => {
            let text = serde_json::to_string(state).map_err(|error| failed(error.to_string()))?;
            Ok(tensor::text(text))
        }
        Form::Bytes => {
            let bytes =
                rmp_serde::to_vec_named(state).map_err(|error| failed(error.to_string()))?;
            Ok(tensor::bytes(bytes))
        }
    }
}

fn read<T: DeserializeOwned>(value: &Tensor, form: Form) -> Answer<T> {
    let state = match (form, &value.payload) {
        (Form::Text, Some(Payload::Strings(StringArray { array }))) if array.len() == 1 => {
            read_json(&array[0])
        }
        (Form::Bytes, Some(Payload::Uint8s(Uint8Array { array }))) => {
            let mut reader = rmp_serde::Deserializer::new(array.as_slice());
            read_fields(&mut reader).and_then(|state| match *reader.get_ref() {
                [] => Ok(state),
                rest => Err(ParameterError::Format(format!("{} bytes too many", rest.len()))),
            })
        }
        (Form::Text, _) => {
            return Err(Refusal::invalid("state: expected one text, as it was read"));
        }
        (Form::Bytes, _) => {
            return Err(Refusal::invalid("state_bytes: expected UINT8, as they were read"));
        }
    };
    state.map_err(|error| refused(error, form))
}

fn refused(error: ParameterError, form: Form) -> Refusal {
    Refusal::invalid(match form {
        Form::Text => format!("state: {error}"),
        Form::Bytes => format!("state_bytes: {error}"),
    })
}

/// The state of all episodes.
pub(crate) fn save(episodes: &Episodes, form: Form) -> Answer<Tensor> {
    match episodes {
        Episodes::Single(episode) => write(&episode.state(), form),
        Episodes::Batch(batch) => write(&batch.state(), form),
        Episodes::Reach { batch, .. } => write(&batch.state(), form),
    }
}

/// Goes on where a state was saved; nothing is changed where it does not fit.
pub(crate) fn load(environment: &mut Environment, value: &Tensor, form: Form) -> Answer<()> {
    let done = match &mut environment.episodes {
        Episodes::Single(episode) => episode.set_state(&read(value, form)?),
        Episodes::Batch(batch) => batch.set_state(&read(value, form)?),
        Episodes::Reach { batch, .. } => batch.set_state(&read(value, form)?),
    };
    done.map_err(|error| refused(error, form))?;
    environment.restored();
    Ok(())
}

#[cfg(test)]
mod tests {
    use octoarm_env::{Autoreset, EpisodeBatch, EpisodeConfig};

    use super::*;

    #[test]
    fn both_forms_hold_every_bit() {
        let config = EpisodeConfig::default().checked().expect("config");
        let configs = vec![config; 3];
        let make = || EpisodeBatch::new(&configs, Some(9), Autoreset::NextStep, Some(1));
        let mut batch = make().expect("batch");
        batch.reset(None, &[Some(1), Some(2), Some(u64::MAX)], None).expect("reset");
        batch.step(&[[0.5, -0.25]; 3]).expect("step");
        let state = batch.state();
        let mut sizes = Vec::new();
        for form in [Form::Text, Form::Bytes] {
            let written = write(&state, form).expect("written");
            sizes.push(match &written.payload {
                Some(Payload::Strings(texts)) => texts.array[0].len(),
                Some(Payload::Uint8s(bytes)) => bytes.array.len(),
                _ => 0,
            });
            assert_eq!(read(&written, form), Ok(state.clone()));
        }
        assert!(sizes[1] > 0 && 2 * sizes[1] < sizes[0], "{sizes:?}");
    }

    #[test]
    fn what_is_no_state_is_refused() {
        let config = EpisodeConfig::default().checked().expect("config");
        let batch = EpisodeBatch::new(&[config], None, Autoreset::NextStep, Some(1));
        let Some(Payload::Uint8s(whole)) =
            write(&batch.expect("batch").state(), Form::Bytes).expect("bytes").payload
        else {
            unreachable!("bytes are an array of UINT8")
        };
        let mut longer = whole.array.clone();
        longer.push(0);
        let cut = whole.array[..whole.array.len() / 2].to_vec();
        for (tensor, expected) in [
            (tensor::bytes(longer), "state_bytes: 1 bytes too many"),
            (tensor::bytes(cut), "state_bytes: episodes[0]"),
            (tensor::bytes(vec![0xC1]), "state_bytes: "),
            (tensor::bytes(Vec::new()), "state_bytes: "),
            (tensor::text("{}"), "state_bytes: expected UINT8"),
        ] {
            let refusal =
                read::<octoarm_env::BatchState>(&tensor, Form::Bytes).expect_err(expected);
            assert!(refusal.message.starts_with(expected), "{}", refusal.message);
        }
    }
}
