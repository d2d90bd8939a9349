//! Compiles the protocol, without a `protoc` of the system.

use std::error::Error;
use std::path::PathBuf;

use prost::Message as _;
use tonic_build::manual;

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo:rerun-if-changed=proto");
    let files = ["dm_env_rpc/v1/dm_env_rpc.proto", "dm_env_rpc/v1/extensions/properties.proto"];
    let descriptors = protox::compile(files, ["proto"])?;
    let out = PathBuf::from(std::env::var("OUT_DIR")?);
    std::fs::write(out.join("descriptors.binpb"), descriptors.encode_to_vec())?;
    // Maps in the order of their keys: what is sent is the same bytes for the same content.
    tonic_prost_build::configure().btree_map(".").build_server(false).compile_fds(descriptors)?;
    // The same service as it is served, with requests as bytes: the server decides where to decode them.
    let process = manual::Method::builder()
        .name("process")
        .route_name("Process")
        .input_type("bytes::Bytes")
        .output_type("crate::protocol::EnvironmentResponse")
        .codec_path("crate::codec::RequestBytesCodec")
        .client_streaming()
        .server_streaming()
        .build();
    let service = manual::Service::builder()
        .name("Environment")
        .package("dm_env_rpc.v1")
        .method(process)
        .build();
    manual::Builder::new().build_client(false).compile(&[service]);
    Ok(())
}
