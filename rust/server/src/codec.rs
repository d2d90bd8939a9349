//! Requests as they come, answers as they are: a large request is not decoded where streams are served.

use bytes::{Buf as _, Bytes};
use octoarm_protocol::{EnvironmentRequest, EnvironmentResponse};
use prost::Message as _;
use tonic::Status;
use tonic::codec::{BufferSettings, Codec, DecodeBuf, Decoder};
use tonic_prost::{ProstCodec, ProstEncoder};

/// The service, whose requests come as bytes.
#[allow(missing_docs, unreachable_pub, unused_qualifications, clippy::all, clippy::pedantic)]
mod generated {
    tonic::include_proto!("dm_env_rpc.v1.Environment");
}

pub(crate) use generated::environment_server::{Environment, EnvironmentServer};

/// Leaves requests encoded.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct RequestBytesCodec;

/// Takes a request's bytes as they are.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct RequestBytes;

impl Decoder for RequestBytes {
    type Item = Bytes;
    type Error = Status;

    fn decode(&mut self, buffer: &mut DecodeBuf<'_>) -> Result<Option<Bytes>, Status> {
        Ok(Some(buffer.copy_to_bytes(buffer.remaining())))
    }
}

impl Codec for RequestBytesCodec {
    type Encode = EnvironmentResponse;
    type Decode = Bytes;
    type Encoder = ProstEncoder<EnvironmentResponse>;
    type Decoder = RequestBytes;

    fn encoder(&mut self) -> Self::Encoder {
        ProstCodec::<EnvironmentResponse, EnvironmentRequest>::raw_encoder(BufferSettings::default())
    }

    fn decoder(&mut self) -> Self::Decoder {
        RequestBytes
    }
}

/// A request from its bytes.
pub(crate) fn decode(bytes: Bytes) -> Result<EnvironmentRequest, Status> {
    EnvironmentRequest::decode(bytes).map_err(|error| Status::internal(error.to_string()))
}
