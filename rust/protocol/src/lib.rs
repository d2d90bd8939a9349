//! The messages and the service of [dm_env_rpc](https://github.com/google-deepmind/dm_env_rpc), version 1,
//! as compiled from `proto/`.

#![allow(missing_docs, unreachable_pub, clippy::all, clippy::pedantic)]

pub use dm_env_rpc::v1::*;
pub use google::rpc::Status;

/// The files of the protocol, for reflection and for clients that compile them.
pub const DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/descriptors.binpb"));

mod dm_env_rpc {
    pub mod v1 {
        tonic::include_proto!("dm_env_rpc.v1");

        pub mod extensions {
            pub mod properties {
                tonic::include_proto!("dm_env_rpc.v1.extensions.properties");
            }
        }
    }
}

mod google {
    pub mod rpc {
        tonic::include_proto!("google.rpc");
    }
}
