//! The service as it is served, with requests as bytes: the server decides where to decode them.

use tonic_build::manual;

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    let process = manual::Method::builder()
        .name("process")
        .route_name("Process")
        .input_type("bytes::Bytes")
        .output_type("octoarm_protocol::EnvironmentResponse")
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
}
