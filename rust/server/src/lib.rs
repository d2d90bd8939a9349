//! The octopus arm as a service: the environments of `octoarm-env` over gRPC, in the protocol
//! [dm_env_rpc](https://github.com/google-deepmind/dm_env_rpc), version 1. No Python in the process.
//!
//! [`Options`] and [`Settings`] say where and for whom, [`Server`] serves. A *world* is an arm with its episodes, or a
//! batch of them; a client makes worlds, joins one a stream, and steps it. What an episode is, is not
//! decided here.

mod auth;
mod environment;
mod listener;
mod metrics;
mod options;
mod properties;
pub mod protocol;
mod reply;
mod server;
mod service;
mod session;
mod sessions;
mod settings;
mod specs;
mod tensor;
mod world;
mod world_settings;
mod worlds;

pub use options::Options;
pub use server::{ServeError, Server};
pub use settings::{LogFormat, Settings, SettingsError};
