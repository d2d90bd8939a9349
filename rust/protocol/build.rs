//! Compiles the protocol, without a `protoc` of the system.

use std::error::Error;
use std::path::PathBuf;

use prost::Message as _;

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo:rerun-if-changed=proto");
    let files = ["dm_env_rpc/v1/dm_env_rpc.proto", "dm_env_rpc/v1/extensions/properties.proto"];
    let descriptors = protox::compile(files, ["proto"])?;
    let out = PathBuf::from(std::env::var("OUT_DIR")?);
    std::fs::write(out.join("descriptors.binpb"), descriptors.encode_to_vec())?;
    // Maps in the order of their keys: what is sent is the same bytes for the same content.
    tonic_prost_build::configure().btree_map(".").build_server(false).compile_fds(descriptors)?;
    Ok(())
}
