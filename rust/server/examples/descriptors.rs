//! Writes the compiled protocol to standard output, without its comments: what the Python client reads.
//!
//! `cargo run --example descriptors -p octoarm-server > octoarm_env/remote/dm_env_rpc.binpb`

use std::io::Write as _;

use octoarm_server::protocol::DESCRIPTORS;
use prost::Message as _;
use prost_types::FileDescriptorSet;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut files = FileDescriptorSet::decode(DESCRIPTORS)?;
    for file in &mut files.file {
        file.source_code_info = None;
    }
    std::io::stdout().write_all(&files.encode_to_vec())?;
    Ok(())
}
