//! The protocol that the Python client reads is the one that the server speaks.
//!
//! `OCTOARM_WRITE=1 cargo test -p octoarm-server --test descriptors` writes it anew.

use octoarm_server::protocol::DESCRIPTORS;
use prost::Message as _;
use prost_types::FileDescriptorSet;

#[test]
fn the_python_client_has_this_protocol() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../octoarm_env/remote/dm_env_rpc.binpb");
    let mut server = FileDescriptorSet::decode(DESCRIPTORS).expect("descriptors");
    for file in &mut server.file {
        file.source_code_info = None;
    }
    if std::env::var_os("OCTOARM_WRITE").is_some() {
        std::fs::write(path, server.encode_to_vec()).expect("the file of the Python client");
    }
    let bytes = std::fs::read(path).expect("the file of the Python client");
    let client = FileDescriptorSet::decode(bytes.as_slice()).expect("descriptors");
    assert_eq!(client, server, "run the command at the head of this file");
}
