//! What CreateWorld and the resets take.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::LazyLock;

use octoarm_arm::{ArmLanes, ArmParameters, read_fields};
use octoarm_env::{Autoreset, CheckedConfig, EpisodeConfig, Senses, Swing, TargetName};
use serde_json::{Map, Value};

use crate::protocol::Tensor;
use crate::reply::{Answer, Refusal, quoted};
use crate::settings::Limits;
use crate::tensor::to_json;

/// Steps of an episode, as `gym.make("OctoArm-v0")` has them.
const MAX_EPISODE_STEPS: u64 = 500;
/// Before the name of a parameter of the body.
const ARM: &str = "arm.";
/// Before the name of a parameter of the body that varies.
const VARY: &str = "vary.";
/// Most numbers of any setting but a target and what the body has for each compartment.
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
    /// What happens when an episode of a batch has ended.
    pub(crate) autoreset: Autoreset,
    /// Threads that share a batch's step.
    pub(crate) threads: usize,
}

/// What starts the generators of phases anew.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Seed {
    /// Episode i of a batch takes this number + i.
    First(u64),
    /// An entry an episode of a batch; without a number its generator goes on.
    Each(Vec<Option<u64>>),
}

impl Seed {
    /// The seed of an episode.
    pub(crate) fn of(&self, index: usize) -> Option<u64> {
        match self {
            Self::First(seed) => Some(seed.wrapping_add(index as u64)),
            Self::Each(seeds) => seeds.get(index).copied().flatten(),
        }
    }
}

/// How the next episode begins.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct NextReset {
    /// Starts the generators of phases anew.
    pub(crate) seed: Option<Seed>,
    /// Where on the target, in turns from 0 to 1; without one it is drawn.
    pub(crate) phase: Option<f64>,
    /// Which episodes of a batch begin anew; without it, all.
    pub(crate) mask: Option<Vec<bool>>,
}

/// What is the world's beside the episode's own settings.
const FRAME: [&str; 5] = ["seed", "num_envs", "max_episode_steps", "autoreset_mode", "threads"];

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
            .filter(|name| name != "vary")
            .chain(body.iter().flat_map(|name| [ARM, VARY].map(|before| format!("{before}{name}"))))
            .chain(FRAME.map(str::to_owned))
            .collect()
    });
    &KNOWN
}

/// Names of the body's parameters that may have a number for each compartment.
fn lists() -> [&'static str; 8] {
    static LISTS: LazyLock<[&str; 8]> =
        LazyLock::new(|| ArmParameters::default().per_compartment().map(|(name, ..)| name));
    *LISTS
}

/// How many arms of the usual size one of these settings counts for.
pub(crate) fn weight(config: &EpisodeConfig) -> f64 {
    (config.arm.compartments as f64 / USUAL_COMPARTMENTS).max(1.0)
}

/// Memory of an arm's episode beside that of the arm itself \[bytes\].
const EPISODE_BYTES: usize = 1 << 10;

/// Memory that a world takes, rounded up \[bytes\]: with its own swings, though worlds that are alike share
/// one.
pub(crate) fn memory(settings: &WorldSettings) -> usize {
    let (config, arms) = (&settings.config, settings.num_envs.unwrap_or(1));
    let groups = arms.div_ceil(ArmLanes::WIDTH);
    let arms = arms.saturating_mul(EPISODE_BYTES.saturating_add(Senses::bytes(
        &config.disturbances(),
        config.arm.compartments.saturating_mul(4),
    )));
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
        let mut vary = Map::new();
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
            let most = match name.strip_prefix(ARM) {
                _ if name == "target" => 2 * MOST_ROWS,
                Some(parameter) if lists().contains(&parameter) => ArmParameters::MAX_COMPARTMENTS,
                _ => FEW,
            };
            let value = to_json(name, tensor, most)?;
            if name == "arm" {
                arm = named_body(&value)?;
            } else if FRAME.contains(&name.as_str()) {
                frame.insert(name.clone(), value);
            } else if let Some(parameter) = name.strip_prefix(ARM) {
                arm.insert(parameter.to_owned(), value);
            } else if let Some(parameter) = name.strip_prefix(VARY) {
                vary.insert(parameter.to_owned(), value);
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
        config.insert("vary".to_owned(), Value::Object(vary));
        let config = read_fields::<EpisodeConfig, _>(Value::Object(config))?.checked()?;

        let seed = frame.get("seed").map(seed).transpose()?;
        let num_envs = frame.get("num_envs");
        let num_envs =
            num_envs.map(|value| count("num_envs", value, limits.max_num_envs)).transpose()?;
        let threads = match frame.get("threads") {
            None => 1,
            // As many as there may be.
            Some(value) if value.as_i64() == Some(0) => limits.max_threads,
            Some(value) => count("threads", value, limits.max_threads)?,
        };
        let autoreset = match frame.get("autoreset_mode") {
            None => Autoreset::NextStep,
            Some(value) => autoreset(value, num_envs)?,
        };
        if config.arm.compartments > limits.max_compartments {
            let range = format!("[1, {}] of this server", limits.max_compartments);
            return Err(out_of_range("arm.compartments", config.arm.compartments, &range));
        }
        let weight = weight(&config);
        let period = f64::from(config.physics_steps());
        let swing = Swing::physics_steps(&config);
        for (what, steps) in [
            ("a step of this world", period * num_envs.unwrap_or(1) as f64),
            ("the swings that its episodes begin from", swing),
        ] {
            let steps = (weight * steps).ceil();
            if steps > limits.max_physics_steps as f64 {
                return Err(Refusal::exhausted(format!(
                    "{what} would take {steps} physics steps of an arm of {USUAL_COMPARTMENTS} \
                     compartments (by control_period, arm.timestep, arm.compartments, num_envs, \
                     bodies); \
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
        Ok(Self { config, seed, num_envs, max_episode_steps, autoreset, threads })
    }
}

/// What happens when an episode of a batch has ended.
fn autoreset(value: &Value, num_envs: Option<usize>) -> Answer<Autoreset> {
    if num_envs.is_none() {
        return Err(Refusal::invalid("autoreset_mode is a batch's: give num_envs too"));
    }
    serde_json::from_value(value.clone()).map_err(|_| {
        let range = "of \"next_step\", \"same_step\", \"disabled\"";
        out_of_range("autoreset_mode", value, range)
    })
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

/// A flag for each of so many episodes.
fn flags(name: &str, value: &Value, count: usize) -> Answer<Vec<bool>> {
    let flags: Option<Vec<bool>> =
        value.as_array().and_then(|flags| flags.iter().map(Value::as_bool).collect());
    flags.filter(|flags| flags.len() == count).ok_or_else(|| {
        Refusal::invalid(format!("{name}: expected {count} (num_envs) booleans, shape ({count})"))
    })
}

/// A seed, or one for each of so many episodes, of which a mask may take some.
fn reset_seed(value: &Value, mask: Option<&Value>, count: Option<usize>) -> Answer<Seed> {
    let (Value::Array(seeds), Some(count)) = (value, count) else {
        return match mask {
            None => Ok(Seed::First(seed(value)?)),
            Some(_) => Err(Refusal::invalid("seed_mask goes with a seed for each of num_envs")),
        };
    };
    if seeds.len() != count {
        let message = format!("seed has {} entries, expected {count} (num_envs)", seeds.len());
        return Err(Refusal::invalid(message));
    }
    let mask = mask.map_or(Ok(vec![true; count]), |mask| flags("seed_mask", mask, count))?;
    let each = seeds.iter().zip(mask);
    Ok(Seed::Each(
        each.map(|(one, taken)| taken.then(|| seed(one)).transpose()).collect::<Answer<_>>()?,
    ))
}

impl NextReset {
    /// Reads and checks the settings of a reset, by the agent of a batch of so many episodes if it is
    /// one.
    pub(crate) fn from_tensors(
        tensors: &BTreeMap<String, Tensor>,
        num_envs: Option<usize>,
    ) -> Answer<Self> {
        let known: &[&str] = match num_envs {
            None => &["phase", "seed"],
            Some(_) => &["phase", "reset_mask", "seed", "seed_mask"],
        };
        if let Some(name) = tensors.keys().find(|name| !known.contains(&name.as_str())) {
            let known = known.join(", ");
            return Err(Refusal::invalid(format!(
                "unknown setting {}; known are {known}",
                quoted(name)
            )));
        }
        let most = num_envs.unwrap_or(1);
        let value =
            |name: &str| tensors.get(name).map(|tensor| to_json(name, tensor, most)).transpose();
        let phase = |value: Value| match value.as_f64() {
            Some(phase) if (0.0..=1.0).contains(&phase) => Ok(phase),
            _ => Err(out_of_range("phase", value, "[0, 1] turns")),
        };
        let seed_mask = value("seed_mask")?;
        let seed = match (value("seed")?, seed_mask.as_ref()) {
            (None, None) => None,
            (None, Some(_)) => return Err(Refusal::invalid("seed_mask needs a seed")),
            (Some(seed), mask) => Some(reset_seed(&seed, mask, num_envs)?),
        };
        let mask = match (value("reset_mask")?, num_envs) {
            (Some(mask), Some(count)) => Some(flags("reset_mask", &mask, count)?),
            _ => None,
        };
        Ok(Self { seed, phase: value("phase")?.map(phase).transpose()?, mask })
    }

    /// What is asked for later goes before what was asked for earlier, and what was to begin anew
    /// still does; `asked` tells whether anything was asked for.
    pub(crate) fn overlay(&mut self, later: Self, asked: bool) {
        self.seed = later.seed.or(self.seed.take());
        self.phase = later.phase.or(self.phase);
        self.mask = match (self.mask.take(), later.mask) {
            (_, None) => None,
            (None, Some(later)) => (!asked).then_some(later),
            (Some(earlier), Some(later)) => {
                Some(earlier.into_iter().zip(later).map(|(one, other)| one || other).collect())
            }
        };
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
        assert_eq!(world.autoreset, Autoreset::NextStep);
    }

    #[test]
    fn every_kind_of_setting_is_read() {
        let world = settings(&[
            ("target", text("lissajous")),
            ("amplitude", doubles(vec![12.0], &[])),
            ("actuator", text("direct")),
            ("arm.compartments", integer(4)),
            ("arm.area_scale", doubles(vec![0.5], &[])),
            ("arm.longitudinal_stiffness", doubles(vec![150.0, 200.0, 250.5, 300.0], &[4])),
            ("arm.plane_mass", doubles(vec![0.01], &[])),
            ("seed", unsigned(u64::MAX)),
            ("num_envs", doubles(vec![3.0], &[])),
            ("max_episode_steps", integer(-1)),
            ("autoreset_mode", text("same_step")),
        ])
        .expect("world");
        assert_eq!(world.config.target, Target::Named(TargetName::Lissajous));
        assert_eq!(world.config.amplitude, Some(12.0));
        assert_eq!(world.config.arm.compartments, 4);
        let stiffness = vec![150.0, 200.0, 250.5, 300.0];
        assert_eq!(world.config.arm.longitudinal_stiffness, stiffness.into());
        assert_eq!(world.config.arm.plane_mass, 0.01.into());
        assert_eq!(world.config.arm.area_scale.to_bits(), 0.5_f64.to_bits());
        assert_eq!((world.seed, world.num_envs), (Some(u64::MAX), Some(3)));
        assert_eq!((world.max_episode_steps, world.autoreset), (None, Autoreset::SameStep));

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
            ("threads", integer(-1), "threads = -1 is outside the allowed range [1, "),
            ("autoreset_mode", text("disabled"), "autoreset_mode is a batch's: give num_envs too"),
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
        let pairs = [("num_envs", integer(2)), ("autoreset_mode", text("never"))];
        let message = settings(&pairs).expect_err("no mode").message;
        assert!(message.contains("autoreset_mode = \"never\" is outside the allowed"), "{message}");
        let large = settings(&[("arm.compartments", integer(200))]).expect_err("large").message;
        assert!(large.contains("arm.compartments = 200"), "{large}");
    }

    #[test]
    fn resets_take_a_seed_and_a_phase() {
        let read = |name: &str, tensor: Tensor| {
            NextReset::from_tensors(&BTreeMap::from([(name.to_owned(), tensor)]), None)
        };
        let next = read("phase", doubles(vec![0.25], &[])).expect("phase");
        assert_eq!(next, NextReset { phase: Some(0.25), ..NextReset::default() });
        assert_eq!(read("seed", integer(3)).map(|next| next.seed), Ok(Some(Seed::First(3))));
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
        let seed = |seed: u64| Some(Seed::First(seed));
        let mut first = NextReset { seed: seed(1), phase: Some(0.5), mask: None };
        first.overlay(NextReset { seed: seed(2), ..NextReset::default() }, true);
        assert_eq!(first, NextReset { seed: seed(2), phase: Some(0.5), mask: None });
    }

    #[test]
    fn resets_of_a_batch_take_masks() {
        let read = |pairs: &[(&str, Tensor)]| {
            let pairs = pairs.iter().map(|(name, tensor)| ((*name).to_owned(), tensor.clone()));
            NextReset::from_tensors(&pairs.collect(), Some(3))
        };
        let mask = |flags: [bool; 3]| bools(flags.to_vec(), &[3]);
        let seeds = Tensor { payload: doubles(vec![5.0, 6.0, 7.0], &[3]).payload, shape: vec![3] };
        let next = read(&[
            ("seed", seeds.clone()),
            ("seed_mask", mask([true, false, true])),
            ("reset_mask", mask([false, true, true])),
        ]);
        let expected = NextReset {
            seed: Some(Seed::Each(vec![Some(5), None, Some(7)])),
            phase: None,
            mask: Some(vec![false, true, true]),
        };
        assert_eq!(next, Ok(expected));
        for (pairs, message) in [
            (&[("seed", doubles(vec![1.0; 2], &[2]))][..], "seed has 2 entries, expected 3"),
            (&[("seed_mask", mask([true; 3]))], "seed_mask needs a seed"),
            (&[("seed", integer(1)), ("seed_mask", mask([true; 3]))], "seed_mask goes with"),
            (&[("reset_mask", bools(vec![true; 2], &[2]))], "reset_mask: expected 3 (num_envs)"),
            (&[("reset_mask", doubles(vec![1.0; 3], &[3]))], "reset_mask: expected 3 (num_envs)"),
            (&[("mask", mask([true; 3]))], "known are phase, reset_mask, seed, seed_mask"),
        ] {
            let found = read(pairs).expect_err(message).message;
            assert!(found.contains(message), "{found}");
        }

        let masked =
            |flags: [bool; 3]| NextReset { mask: Some(flags.to_vec()), ..NextReset::default() };
        let mut next = NextReset::default();
        next.overlay(masked([true, false, false]), false);
        next.overlay(masked([false, true, false]), true);
        assert_eq!(next.mask, Some(vec![true, true, false]));
        next.overlay(NextReset::default(), true);
        next.overlay(masked([false, true, false]), true);
        assert_eq!(next.mask, None);
    }
}
