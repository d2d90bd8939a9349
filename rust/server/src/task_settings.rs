//! What the arms of a world do, and the settings that are the task's own.

use std::collections::BTreeSet;
use std::sync::LazyLock;

use octoarm_arm::{ArmParameters, read_fields};
use octoarm_env::{
    CheckedConfig, Disturbances, EpisodeConfig, ReachBodies, ReachConfig, Swing, TargetName,
    reachable_goals,
};
use serde::Deserialize;
use serde_json::{Map, Value};

use crate::reply::{Answer, Refusal, quoted};

/// Before the name of a parameter of the body.
pub(crate) const ARM: &str = "arm.";
/// Before the name of a parameter of the body that varies.
pub(crate) const VARY: &str = "vary.";
/// Most rows of a target, a period of 65 s at 1 ms, and most goals.
const MOST_ROWS: usize = 1 << 16;
/// Most numbers of any other setting, but for those of every compartment.
const FEW: usize = 16;

/// What is the world's beside the episode's own settings.
#[rustfmt::skip]
pub(crate) const FRAME: [&str; 6] = ["task", "seed", "num_envs", "max_episode_steps", "autoreset_mode", "threads"];

/// What the arms of a world do.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum TaskName {
    /// Their bases follow a limit cycle, as in `OctoArm-v0`.
    #[default]
    LimitCycle,
    /// Their muscles bring the tips to goals, as in `OctoArmReach-v0`.
    Reach,
}

impl TaskName {
    const ALL: [Self; 2] = [Self::LimitCycle, Self::Reach];

    /// The name, as it is set.
    fn name(self) -> &'static str {
        match self {
            Self::LimitCycle => "limit_cycle",
            Self::Reach => "reach",
        }
    }

    /// The task of this name.
    pub(crate) fn read(value: &Value) -> Answer<Self> {
        serde_json::from_value(value.clone()).map_err(|_| {
            let names = Self::ALL.map(|task| format!("{:?}", task.name())).join(", ");
            Refusal::out_of_range("task", value, &format!("of {names}"))
        })
    }

    /// Steps of an episode, as `gym.make` has them.
    pub(crate) fn max_episode_steps(self) -> u64 {
        match self {
            Self::LimitCycle => 500,
            Self::Reach => 100,
        }
    }

    /// Most numbers of a setting.
    pub(crate) fn most(setting: &str) -> usize {
        match setting {
            "target" => 2 * MOST_ROWS,
            "goals" => 3 * MOST_ROWS,
            _ if setting.strip_prefix(ARM).is_some_and(|name| lists().contains(&name)) => {
                ArmParameters::MAX_COMPARTMENTS
            }
            _ => FEW,
        }
    }

    /// Names of all settings of a world.
    fn known(self) -> &'static BTreeSet<String> {
        static KNOWN: LazyLock<[BTreeSet<String>; 2]> = LazyLock::new(|| {
            let names = |value: Result<Value, serde_json::Error>| match value {
                Ok(Value::Object(fields)) => fields.into_iter().map(|(name, _)| name).collect(),
                _ => Vec::new(),
            };
            let body = names(serde_json::to_value(ArmParameters::default()));
            let all = |own: Vec<String>| -> BTreeSet<String> {
                let own = own.into_iter().filter(|name| name != "vary");
                let of_body = |name: &String| [ARM, VARY].map(|before| format!("{before}{name}"));
                own.chain(body.iter().flat_map(of_body)).chain(FRAME.map(str::to_owned)).collect()
            };
            let mut reach = names(serde_json::to_value(ReachConfig::default()));
            reach.push("goals".to_owned());
            [all(names(serde_json::to_value(EpisodeConfig::default()))), all(reach)]
        });
        &KNOWN[self as usize]
    }

    /// Refuses a setting that a world of this task has not.
    pub(crate) fn check_known(self, setting: &str) -> Answer<()> {
        if self.known().contains(setting) {
            return Ok(());
        }
        let other = Self::ALL.into_iter().find(|task| task.known().contains(setting));
        let other =
            other.map(|task| format!(" with task = {:?}, but of {:?}", self.name(), task.name()));
        let known: Vec<&str> = self.known().iter().map(String::as_str).collect();
        Err(Refusal::invalid(format!(
            "unknown setting {}{}; known are {}",
            quoted(setting),
            other.unwrap_or_default(),
            known.join(", ")
        )))
    }
}

/// Names of the body's parameters that may have a number for each compartment.
fn lists() -> [&'static str; 8] {
    static LISTS: LazyLock<[&str; 8]> =
        LazyLock::new(|| ArmParameters::default().per_compartment().map(|(name, ..)| name));
    *LISTS
}

/// Checked settings of the episodes of a world.
#[derive(Clone, Debug)]
pub(crate) enum TaskSettings {
    /// Of those that follow a limit cycle.
    LimitCycle(CheckedConfig),
    /// Of those that reach, with their bodies as far as they are made.
    Reach(Box<ReachBodies>),
}

impl TaskSettings {
    /// Reads and checks the settings of a task by their names, but for the world's own.
    pub(crate) fn read(task: TaskName, mut settings: Map<String, Value>) -> Answer<Self> {
        if let Some(target) = settings.get("target") {
            check_target(target)?;
        }
        let goals = settings.remove("goals");
        let settings = Value::Object(settings);
        match task {
            TaskName::LimitCycle => {
                Ok(Self::LimitCycle(read_fields::<EpisodeConfig, _>(settings)?.checked()?))
            }
            TaskName::Reach => {
                /// What a message names them by.
                #[derive(Deserialize)]
                struct Goals {
                    goals: Vec<[f64; 3]>,
                }
                let goals = match goals {
                    None => reachable_goals().to_vec(),
                    Some(goals) => {
                        let named = Map::from_iter([("goals".to_owned(), goals)]);
                        read_fields::<Goals, _>(Value::Object(named))?.goals
                    }
                };
                let config = read_fields::<ReachConfig, _>(settings)?;
                Ok(Self::Reach(Box::new(ReachBodies::new(config, goals)?)))
            }
        }
    }

    /// The body, before it varies.
    pub(crate) fn arm(&self) -> &ArmParameters {
        match self {
            Self::LimitCycle(config) => &config.arm,
            Self::Reach(bodies) => &bodies.config().arm,
        }
    }

    /// Physics steps from one action to the next.
    pub(crate) fn physics_steps(&self) -> u32 {
        match self {
            Self::LimitCycle(config) => config.physics_steps(),
            Self::Reach(bodies) => bodies.config().physics_steps(),
        }
    }

    /// Physics steps before the first episode, in all.
    pub(crate) fn first_physics_steps(&self) -> f64 {
        match self {
            Self::LimitCycle(config) => Swing::physics_steps(config),
            Self::Reach(_) => 0.0,
        }
    }

    /// What lies between the agent and the body.
    pub(crate) fn disturbances(&self) -> Disturbances {
        match self {
            Self::LimitCycle(config) => config.disturbances(),
            Self::Reach(bodies) => bodies.config().disturbances(),
        }
    }

    /// Memory of what the episodes share, rounded up \[bytes\]: with its own swings, though worlds that are
    /// alike share one.
    pub(crate) fn shared_bytes(&self) -> usize {
        match self {
            Self::LimitCycle(config) => Swing::bytes(config),
            Self::Reach(bodies) => bodies.bytes(),
        }
    }

    /// Memory of an episode beside that of arm and readings, rounded up \[bytes\].
    pub(crate) fn episode_bytes(&self) -> usize {
        /// Of any episode.
        const FIXED: usize = 1 << 10;
        match self {
            Self::LimitCycle(_) => FIXED,
            Self::Reach(bodies) => {
                // Activations and actions; what was seen, of lengths and rates.
                let config = bodies.config();
                let numbers = 2 * config.muscles() + 8 * config.arm.compartments;
                FIXED.saturating_add(numbers.saturating_mul(size_of::<f64>()))
            }
        }
    }
}

/// A name for a target must be one of those that there are.
fn check_target(value: &Value) -> Answer<()> {
    let Value::String(name) = value else { return Ok(()) };
    if serde_json::from_value::<TargetName>(value.clone()).is_ok() {
        return Ok(());
    }
    let names = [TargetName::Quadratic, TargetName::VanDerPol, TargetName::Lissajous];
    let names: Vec<String> =
        names.iter().filter_map(|name| serde_json::to_string(name).ok()).collect();
    Err(Refusal::invalid(format!(
        "target = {}: expected {}, or an array (T, 2)",
        quoted(name),
        names.join(", ")
    )))
}
