//! Python's view of the arm and the episode: arrays in, arrays out, errors mapped, GIL released; and of a
//! stream to a server.

mod arm;
mod arm_batch;
mod arrays;
mod episode;
mod episode_batch;
mod errors;
mod infos;
mod messages;
mod reach;
mod stream;
mod tensor;

/// The compiled core of `octoarm_env`; use the typed package around it.
#[pyo3::pymodule]
mod _core {
    use octoarm_arm::{ArmParameters, InstructionSet};
    use pyo3::prelude::*;

    #[pymodule_export]
    use crate::arm::Arm;
    #[pymodule_export]
    use crate::arm_batch::ArmBatch;
    #[pymodule_export]
    use crate::episode::Episode;
    #[pymodule_export]
    use crate::episode::{check_step, drawn_bodies, limit_cycle_orbit, limit_cycle_signal};
    #[pymodule_export]
    use crate::episode_batch::{EpisodeBatch, check_actions};
    #[pymodule_export]
    use crate::errors::DomainError;
    use crate::errors::invalid;
    #[pymodule_export]
    use crate::messages::Request;
    #[pymodule_export]
    use crate::reach::{
        ReachBatch, check_reach_actions, drawn_reach_bodies, reach_rewards, reachable_goals,
    };
    #[pymodule_export]
    use crate::stream::Stream;

    /// The named bodies with all their parameters, as JSON text.
    #[pyfunction]
    fn preset_parameters() -> PyResult<String> {
        let bodies: PyResult<Vec<String>> = ArmParameters::PRESETS
            .iter()
            .map(|name| {
                let body = ArmParameters::preset(name).and_then(|body| body.to_json());
                Ok(format!("{name:?}: {}", body.map_err(invalid)?))
            })
            .collect();
        Ok(format!("{{{}}}", bodies?.join(", ")))
    }

    /// Parses and validates parameters given as JSON text; returns them complete.
    #[pyfunction]
    fn check_parameters(text: &str) -> PyResult<String> {
        ArmParameters::from_json(text).and_then(|parameters| parameters.to_json()).map_err(invalid)
    }

    /// The vector instructions in use: "baseline", "avx2" or "avx512".
    #[pyfunction]
    fn instruction_set() -> &'static str {
        match InstructionSet::detected() {
            InstructionSet::Baseline => "baseline",
            InstructionSet::Avx2 => "avx2",
            InstructionSet::Avx512 => "avx512",
        }
    }
}
