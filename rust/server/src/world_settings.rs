//! What CreateWorld and the resets take.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::LazyLock;

use octoarm_arm::{ArmLanes, ArmParameters, read_fields};
use octoarm_env::{CheckedConfig, EpisodeConfig, Swing, TargetName};
use serde_json::{Map, Value};

use crate::protocol::Tensor;
use crate::reply::{Answer, Refusal, quoted};
use crate::settings::Limits;
use crate::tensor::to_json;

/// Steps of an episode, as `gym.make("OctoArm-v0")` has them.
const MAX_EPISODE_STEPS: u64 = 500;
/// Before the name of a parameter of the body.
const ARM: &str = "arm.";
/// Most numbers of any setting but a target.
const FEW: usize = 16;
/// Most rows of a target: a period of 65 s at 1 ms.
const MOST_ROWS: usize = 1 << 16;
/// Compartments of the arm that costs are counted in.
const USUAL_COMPARTMENTS: f64 = 20.0;
/// A world as it was asked for.
#[derive(Clone, Debug)]
pub(crate) struct WorldSettings {
    /// The episodes.
    pub(crate) config: CheckedConfig,
    /// Of the first episode's phase; episode i of a batch takes `seed + i`.
    pub(crate) seed: Option<u64>,
    /// Episodes of a batch; without a number the world is a single arm.
    pub(crate) num_envs: Option<usize>,
    /// Steps after which an episode is truncated.
    pub(crate) max_episode_steps: Option<u64>,
    /// Threads that share a batch's step.
    pub(crate) threads: usize,
}

/// How the next episode begins.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct NextReset {
    /// Starts the generator of phases anew.
    pub(crate) seed: Option<u64>,
    /// Where on the target, in turns from 0 to 1; without one it is drawn.
    pub(crate) phase: Option<f64>,
}

/// What is the world's beside the episode's own settings.
const FRAME: [&str; 4] = ["seed", "num_envs", "max_episode_steps", "threads"];

fn out_of_range(name: &str, value: impl std::fmt::Display, range: &str) -> Refusal {
    Refusal::invalid(format!("{name} = {value} is outside the allowed range {range}"))
}

/// A whole number from `low` to `high`.
fn whole(name: &str, value: &Value, low: i64, high: u64, range: &str) -> Answer<i128> {
    let number = value.as_i64().map(i128::from).or(value.as_u64().map(i128::from));
    number
        .filter(|number| (i128::from(low)..=i128::from(high)).contains(number))
        .ok_or_else(|| out_of_range(name, value, range))
}

fn seed(value: &Value) -> Answer<u64> {
    Ok(whole("seed", value, 0, u64::MAX, "[0, 2^64) of whole numbers")? as u64)
}

/// A number from 1 to a limit of the server.
fn count(name: &str, value: &Value, most: usize) -> Answer<usize> {
    let range = format!("[1, {most}] of whole numbers on this server");
    Ok(whole(name, value, 1, most as u64, &range)? as usize)
}

/// Names of all settings of a world.
fn known() -> &'static BTreeSet<String> {
    static KNOWN: LazyLock<BTreeSet<String>> = LazyLock::new(|| {
        let names = |value: Result<Value, serde_json::Error>| match value {
            Ok(Value::Object(fields)) => fields.into_iter().map(|(name, _)| name).collect(),
            _ => Vec::new(),
        };
        let body = names(serde_json::to_value(ArmParameters::default()));
        names(serde_json::to_value(EpisodeConfig::default()))
            .into_iter()
            .chain(body.into_iter().map(|name| format!("{ARM}{name}")))
            .chain(FRAME.map(str::to_owned))
            .collect()
    });
    &KNOWN
}

/// How many arms of the usual size one of these settings counts for.
pub(crate) fn weight(config: &EpisodeConfig) -> f64 {
    (config.arm.compartments as f64 / USUAL_COMPARTMENTS).max(1.0)
}

/// Memory of an arm's episode beside that of the arm itself \[bytes\].
const EPISODE_BYTES: usize = 1 << 10;

/// Memory that a world takes, rounded up \[bytes\]: with its own swing, though worlds that are alike share
/// one.
pub(crate) fn memory(settings: &WorldSettings) -> usize {
    let (config, arms) = (&settings.config, settings.num_envs.unwrap_or(1));
    let groups = arms.div_ceil(ArmLanes::WIDTH);
    let arms = arms.saturating_mul(EPISODE_BYTES);
    let groups = groups.saturating_mul(ArmLanes::bytes(config.arm.compartments));
    Swing::bytes(config).saturating_add(groups).saturating_add(arms)
}

/// All parameters of a body that is told by its name.
fn named_body(name: &Value) -> Answer<Map<String, Value>> {
    let text = name.as_str().map_or_else(|| name.to_string(), str::to_owned);
    match serde_json::to_value(ArmParameters::preset(&text)?) {
        Ok(Value::Object(body)) => Ok(body),
        _ => Err(Refusal::new(tonic::Code::Internal, "a named body is no object")),
    }
}

impl WorldSettings {
    /// Reads and checks the settings of CreateWorld; what is left out takes its default.
    pub(crate) fn from_tensors(
        tensors: &BTreeMap<String, Tensor>,
        limits: &Limits,
    ) -> Answer<Self> {
        let (mut config, mut frame, mut arm) = (Map::new(), Map::new(), Map::new());
        if let Some(name) = tensors.keys().find(|name| !known().contains(*name)) {
            let known: Vec<&str> = known().iter().map(String::as_str).collect();
            return Err(Refusal::invalid(format!(
                "unknown setting {}; known are {}",
                quoted(name),
                known.join(", ")
            )));
        }
        // In the order of their names: "arm", a whole body, comes before "arm.…", changes to it.
        for (name, tensor) in tensors {
            let most = if name == "target" { 2 * MOST_ROWS } else { FEW };
            let value = to_json(name, tensor, most)?;
            if name == "arm" {
                arm = named_body(&value)?;
            } else if FRAME.contains(&name.as_str()) {
                frame.insert(name.clone(), value);
            } else if let Some(parameter) = name.strip_prefix(ARM) {
                arm.insert(parameter.to_owned(), value);
            } else {
                if name == "target" {
                    check_target(&value)?;
                }
                config.insert(name.clone(), value);
            }
        }
        if !arm.is_empty() {
            config.insert("arm".to_owned(), Value::Object(arm));
        }
        let config = read_fields::<EpisodeConfig, _>(Value::Object(config))?.checked()?;

        let seed = frame.get("seed").map(seed).transpose()?;
        let num_envs = frame.get("num_envs");
        let num_envs =
            num_envs.map(|value| count("num_envs", value, limits.max_num_envs)).transpose()?;
        let threads = frame
            .get("threads")
            .map_or(Ok(1), |value| count("threads", value, limits.max_threads))?;
        if config.arm.compartments > limits.max_compartments {
            let range = format!("[1, {}] of this server", limits.max_compartments);
            return Err(out_of_range("arm.compartments", config.arm.compartments, &range));
        }
        let weight = weight(&config);
        let period = f64::from(config.physics_steps());
        let swing = Swing::physics_steps(&config);
        for (what, steps) in [
            ("a step of this world", period * num_envs.unwrap_or(1) as f64),
            ("the swing that its episodes begin from", swing),
        ] {
            let steps = (weight * steps).ceil();
            if steps > limits.max_physics_steps as f64 {
                return Err(Refusal::exhausted(format!(
                    "{what} would take {steps} physics steps of an arm of {USUAL_COMPARTMENTS} \
                     compartments (by control_period, arm.timestep, arm.compartments, num_envs); \
                     this server allows {} a request",
                    limits.max_physics_steps
                )));
            }
        }
        let max_episode_steps = match frame.get("max_episode_steps") {
            None => Some(MAX_EPISODE_STEPS),
            Some(value) if value.as_i64() == Some(-1) => None,
            Some(value) => {
                let range = "[1, 2^32) of whole numbers, or -1 for no end";
                Some(whole("max_episode_steps", value, 1, u32::MAX.into(), range)? as u64)
            }
        };
        Ok(Self { config, seed, num_envs, max_episode_steps, threads })
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

impl NextReset {
    /// Reads and checks the settings of a reset.
    pub(crate) fn from_tensors(tensors: &BTreeMap<String, Tensor>) -> Answer<Self> {
        if let Some(name) = tensors.keys().find(|name| !["seed", "phase"].contains(&name.as_str()))
        {
            return Err(Refusal::invalid(format!(
                "unknown setting {}; known are phase, seed",
                quoted(name)
            )));
        }
        let value =
            |name: &str| tensors.get(name).map(|tensor| to_json(name, tensor, 1)).transpose();
        let phase = |value: Value| match value.as_f64() {
            Some(phase) if (0.0..=1.0).contains(&phase) => Ok(phase),
            _ => Err(out_of_range("phase", value, "[0, 1] turns")),
        };
        Ok(Self {
            seed: value("seed")?.as_ref().map(seed).transpose()?,
            phase: value("phase")?.map(phase).transpose()?,
        })
    }

    /// What is asked for later goes before what was asked for earlier.
    pub(crate) fn overlay(&mut self, later: Self) {
        self.seed = later.seed.or(self.seed);
        self.phase = later.phase.or(self.phase);
    }
}

#[cfg(test)]
mod tests {
    use octoarm_env::{Target, TargetName};

    use super::*;
    use crate::tensor::{bools, doubles, integer, text, unsigned};

    fn settings(pairs: &[(&str, Tensor)]) -> Answer<WorldSettings> {
        let map = pairs.iter().map(|(name, tensor)| ((*name).to_owned(), tensor.clone())).collect();
        WorldSettings::from_tensors(&map, &Limits::default())
    }

    #[test]
    fn what_is_left_out_takes_its_default() {
        let world = settings(&[]).expect("world");
        assert_eq!(*world.config, EpisodeConfig::default());
        assert_eq!((world.num_envs, world.max_episode_steps, world.seed), (None, Some(500), None));
    }

    #[test]
    fn every_kind_of_setting_is_read() {
        let world = settings(&[
            ("target", text("lissajous")),
            ("amplitude", doubles(vec![12.0], &[])),
            ("actuator", text("direct")),
            ("arm.compartments", integer(4)),
            ("arm.area_scale", doubles(vec![0.5], &[])),
            ("seed", unsigned(u64::MAX)),
            ("num_envs", doubles(vec![3.0], &[])),
            ("max_episode_steps", integer(-1)),
        ])
        .expect("world");
        assert_eq!(world.config.target, Target::Named(TargetName::Lissajous));
        assert_eq!(world.config.amplitude, Some(12.0));
        assert_eq!(world.config.arm.compartments, 4);
        assert_eq!(world.config.arm.area_scale.to_bits(), 0.5_f64.to_bits());
        assert_eq!((world.seed, world.num_envs), (Some(u64::MAX), Some(3)));
        assert_eq!(world.max_episode_steps, None);

        let named =
            settings(&[("arm", text("inertial")), ("arm.area_scale", doubles(vec![0.5], &[]))])
                .expect("world");
        let body = ArmParameters { area_scale: 0.5, ..ArmParameters::inertial() };
        assert_eq!(named.config.arm, body);

        let square = vec![0.5, 0.5, -0.5, 0.5, -0.5, -0.5, 0.5, -0.5];
        let samples = settings(&[("target", doubles(square, &[-1, 2]))]);
        let samples = samples.map(|world| world.config.target.clone());
        let rows = vec![[0.5, 0.5], [-0.5, 0.5], [-0.5, -0.5], [0.5, -0.5]];
        assert_eq!(samples, Ok(Target::Samples(rows)));
    }

    #[test]
    fn bad_settings_are_named() {
        let scalar = |value: f64| doubles(vec![value], &[]);
        for (name, tensor, expected) in [
            ("amplitude", scalar(-3.0), "amplitude = -3"),
            ("amplitude", scalar(f64::INFINITY), "amplitude = inf"),
            ("amplitude", text("big"), "amplitude: invalid type"),
            (
                "target",
                text("square"),
                "target = \"square\": expected \"quadratic\", \"van_der_pol\"",
            ),
            ("colour", integer(1), "colour"),
            ("arm", text("{}"), "arm = \"{}\" is outside the allowed range of named bodies"),
            ("arm", integer(1), "arm = \"1\" is outside the allowed range of named bodies"),
            ("arm.colour", integer(1), "unknown setting \"arm.colour\""),
            ("arm.timestep", scalar(-1.0), "timestep = -1"),
            ("arm.compartments", scalar(2.5), "arm.compartments: invalid type"),
            ("seed", integer(-1), "seed = -1 is outside the allowed range [0, 2^64)"),
            ("seed", bools(vec![true], &[]), "seed = true is outside the allowed range [0, 2^64)"),
            ("num_envs", integer(0), "num_envs = 0 is outside the allowed range [1, 1024]"),
            ("num_envs", integer(-1), "num_envs = -1 is outside the allowed range [1, 1024]"),
            ("num_envs", scalar(2.5), "num_envs = 2.5 is outside the allowed range [1, 1024]"),
            ("num_envs", unsigned(u64::MAX), "num_envs = 18446744073709551615 is outside"),
            ("num_envs", text("many"), "num_envs = \"many\" is outside the allowed range"),
            ("num_envs", doubles(vec![2.0; 2], &[2]), "num_envs = [2,2] is outside"),
            ("threads", integer(0), "threads = 0 is outside the allowed range [1, "),
            ("threads", scalar(2.0_f64.powi(70)), "threads = 1.1805916207174113e+21 is outside"),
            ("threads", scalar(1.5), "threads = 1.5 is outside the allowed range [1, "),
            ("max_episode_steps", integer(0), "max_episode_steps = 0 is outside"),
            ("max_episode_steps", integer(-2), "max_episode_steps = -2 is outside"),
            ("max_episode_steps", integer(1 << 32), "= 4294967296 is outside the allowed range"),
            ("max_episode_steps", scalar(10.5), "= 10.5 is outside the allowed range [1, 2^32)"),
            ("control_period", scalar(0.0105), "control_period = 0.0105"),
        ] {
            let message = settings(&[(name, tensor)]).expect_err(name).message;
            assert!(message.contains(expected), "{name}: {message}");
        }
        for (much, expected) in [
            (
                &[("control_period", scalar(2.0)), ("num_envs", integer(1024))][..],
                "2048000 physics",
            ),
            (&[("control_period", scalar(10.0))], "2570000 physics"),
            (&[("control_period", scalar(1e-9)), ("arm.timestep", scalar(1e-9))], "the swing"),
            (&[("control_period", scalar(1e-300)), ("arm.timestep", scalar(1e-300))], "the swing"),
            (&[("arm.compartments", integer(60)), ("control_period", scalar(2.0))], "the swing"),
        ] {
            let refusal = settings(much).expect_err("too much");
            assert_eq!(refusal.code, tonic::Code::ResourceExhausted);
            assert!(refusal.message.contains(expected), "{}", refusal.message);
        }
        let large = settings(&[("arm.compartments", integer(200))]).expect_err("large").message;
        assert!(large.contains("arm.compartments = 200"), "{large}");
    }

    #[test]
    fn resets_take_a_seed_and_a_phase() {
        let read = |name: &str, tensor: Tensor| {
            NextReset::from_tensors(&BTreeMap::from([(name.to_owned(), tensor)]))
        };
        let next = read("phase", doubles(vec![0.25], &[])).expect("phase");
        assert_eq!(next, NextReset { seed: None, phase: Some(0.25) });
        assert_eq!(read("seed", integer(3)).map(|next| next.seed), Ok(Some(3)));
        assert!(
            read("phase", doubles(vec![1.5], &[]))
                .expect_err("bad")
                .message
                .contains("phase = 1.5")
        );
        assert!(read("amplitude", integer(3)).expect_err("bad").message.contains("amplitude"));
        for (name, tensor, expected) in [
            ("seed", integer(-1), "seed = -1 is outside the allowed range [0, 2^64)"),
            ("phase", text("half"), "phase = \"half\" is outside the allowed range [0, 1] turns"),
        ] {
            assert!(read(name, tensor).expect_err(name).message.contains(expected));
        }
        let mut first = NextReset { seed: Some(1), phase: Some(0.5) };
        first.overlay(NextReset { seed: Some(2), phase: None });
        assert_eq!(first, NextReset { seed: Some(2), phase: Some(0.5) });
    }
}
