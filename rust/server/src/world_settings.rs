//! What CreateWorld takes.

use std::collections::BTreeMap;

use octoarm_arm::{ArmLanes, ArmParameters};
use octoarm_env::{Autoreset, Senses};
use octoarm_protocol::Tensor;
use serde_json::{Map, Value};

use crate::next_reset::{seed, whole};
use crate::reply::{Answer, Refusal};
use crate::settings::Limits;
use crate::task_settings::{ARM, FRAME, TaskName, TaskSettings, VARY};
use crate::tensor::to_json;

/// Compartments of the arm that costs are counted in.
const USUAL_COMPARTMENTS: f64 = 20.0;

/// A world as it was asked for.
#[derive(Clone, Debug)]
pub(crate) struct WorldSettings {
    /// The episodes.
    pub(crate) task: TaskSettings,
    /// Of the first episode's begin; episode i of a batch takes `seed + i`.
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

/// A number from 1 to a limit of the server.
fn count(name: &str, value: &Value, most: usize) -> Answer<usize> {
    let range = format!("[1, {most}] of whole numbers on this server");
    Ok(whole(name, value, 1, most as u64, &range)? as usize)
}

/// How many arms of the usual size one of this body counts for.
pub(crate) fn weight(arm: &ArmParameters) -> f64 {
    (arm.compartments as f64 / USUAL_COMPARTMENTS).max(1.0)
}

/// Memory that a world takes, rounded up \[bytes\].
pub(crate) fn memory(settings: &WorldSettings) -> usize {
    let (task, arms) = (&settings.task, settings.num_envs.unwrap_or(1));
    let compartments = task.arm().compartments;
    let groups = arms.div_ceil(ArmLanes::WIDTH).saturating_mul(ArmLanes::bytes(compartments));
    let readings = Senses::bytes(&task.disturbances(), compartments.saturating_mul(4));
    let episodes = arms.saturating_mul(task.episode_bytes().saturating_add(readings));
    task.shared_bytes().saturating_add(groups).saturating_add(episodes)
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
        let task = match tensors.get("task") {
            None => TaskName::default(),
            Some(task) => TaskName::read(&to_json("task", task, 1)?)?,
        };
        tensors.keys().try_for_each(|name| task.check_known(name))?;
        // In the order of their names: "arm", a whole body, comes before "arm.…", changes to it.
        for (name, tensor) in tensors {
            let value = to_json(name, tensor, TaskName::most(name))?;
            if name == "arm" {
                arm = named_body(&value)?;
            } else if FRAME.contains(&name.as_str()) {
                frame.insert(name.clone(), value);
            } else if let Some(parameter) = name.strip_prefix(ARM) {
                arm.insert(parameter.to_owned(), value);
            } else if let Some(parameter) = name.strip_prefix(VARY) {
                vary.insert(parameter.to_owned(), value);
            } else {
                config.insert(name.clone(), value);
            }
        }
        if !arm.is_empty() {
            config.insert("arm".to_owned(), Value::Object(arm));
        }
        config.insert("vary".to_owned(), Value::Object(vary));
        let settings = TaskSettings::read(task, config)?;

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
        let compartments = settings.arm().compartments;
        if compartments > limits.max_compartments {
            let range = format!("[1, {}] of this server", limits.max_compartments);
            return Err(Refusal::out_of_range("arm.compartments", compartments, &range));
        }
        let weight = weight(settings.arm());
        let period = f64::from(settings.physics_steps());
        for (what, steps) in [
            ("a step of this world", period * num_envs.unwrap_or(1) as f64),
            ("the swings that its episodes begin from", settings.first_physics_steps()),
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
            None => Some(task.max_episode_steps()),
            Some(value) if value.as_i64() == Some(-1) => None,
            Some(value) => {
                let range = "[1, 2^32) of whole numbers, or -1 for no end";
                Some(whole("max_episode_steps", value, 1, u32::MAX.into(), range)? as u64)
            }
        };
        Ok(Self { task: settings, seed, num_envs, max_episode_steps, autoreset, threads })
    }
}

/// What happens when an episode of a batch has ended.
fn autoreset(value: &Value, num_envs: Option<usize>) -> Answer<Autoreset> {
    if num_envs.is_none() {
        return Err(Refusal::invalid("autoreset_mode is a batch's: give num_envs too"));
    }
    serde_json::from_value(value.clone()).map_err(|_| {
        let range = "of \"next_step\", \"same_step\", \"disabled\"";
        Refusal::out_of_range("autoreset_mode", value, range)
    })
}

#[cfg(test)]
mod tests {
    use octoarm_env::{
        CheckedConfig, EpisodeConfig, ReachBodies, ReachConfig, ReachReward, Target, TargetName,
        reachable_goals,
    };

    use super::*;
    use crate::tensor::{bools, doubles, integer, text, unsigned};

    fn settings(pairs: &[(&str, Tensor)]) -> Answer<WorldSettings> {
        let map = pairs.iter().map(|(name, tensor)| ((*name).to_owned(), tensor.clone())).collect();
        WorldSettings::from_tensors(&map, &Limits::default())
    }

    fn config(world: &WorldSettings) -> &CheckedConfig {
        match &world.task {
            TaskSettings::LimitCycle(config) => config,
            TaskSettings::Reach(_) => unreachable!("a limit cycle"),
        }
    }

    fn reaching(pairs: &[(&str, Tensor)]) -> Answer<(WorldSettings, ReachBodies)> {
        let world = settings(&[&[("task", text("reach"))], pairs].concat())?;
        match &world.task {
            TaskSettings::Reach(bodies) => Ok((world.clone(), (**bodies).clone())),
            TaskSettings::LimitCycle(_) => unreachable!("reaching"),
        }
    }

    #[test]
    fn what_is_left_out_takes_its_default() {
        let world = settings(&[]).expect("world");
        assert_eq!(**config(&world), EpisodeConfig::default());
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
        assert_eq!(config(&world).target, Target::Named(TargetName::Lissajous));
        assert_eq!(config(&world).amplitude, Some(12.0));
        assert_eq!(config(&world).arm.compartments, 4);
        let stiffness = vec![150.0, 200.0, 250.5, 300.0];
        assert_eq!(config(&world).arm.longitudinal_stiffness, stiffness.into());
        assert_eq!(config(&world).arm.plane_mass, 0.01.into());
        assert_eq!(config(&world).arm.area_scale.to_bits(), 0.5_f64.to_bits());
        assert_eq!((world.seed, world.num_envs), (Some(u64::MAX), Some(3)));
        assert_eq!((world.max_episode_steps, world.autoreset), (None, Autoreset::SameStep));

        let named =
            settings(&[("arm", text("inertial")), ("arm.area_scale", doubles(vec![0.5], &[]))])
                .expect("world");
        let body = ArmParameters { area_scale: 0.5, ..ArmParameters::inertial() };
        assert_eq!(config(&named).arm, body);

        let square = vec![0.5, 0.5, -0.5, 0.5, -0.5, -0.5, 0.5, -0.5];
        let samples = settings(&[("target", doubles(square, &[-1, 2]))]);
        let samples = samples.map(|world| config(&world).target.clone());
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
    fn a_world_that_reaches_is_read() {
        let (world, bodies) = reaching(&[]).expect("world");
        assert_eq!(*bodies.config(), ReachConfig::default());
        assert_eq!(bodies.goals(), reachable_goals());
        assert_eq!((world.num_envs, world.max_episode_steps), (None, Some(100)));

        let (world, bodies) = reaching(&[
            ("segments", integer(2)),
            ("reward_type", text("dense")),
            ("observe_rates", bools(vec![true], &[])),
            ("goals", doubles(vec![0.1, -0.0, 1.0 / 3.0, 0.0, 1.0, 0.25], &[2, 3])),
            ("arm.compartments", integer(4)),
            ("vary.arm_density", doubles(vec![0.9, 1.0], &[2])),
            ("bodies", integer(3)),
            ("num_envs", integer(9)),
            ("max_episode_steps", integer(7)),
        ])
        .expect("world");
        let config = bodies.config();
        assert_eq!((config.segments, config.muscles(), config.arm.compartments), (2, 10, 4));
        assert_eq!((config.reward_type, config.observe_rates), (ReachReward::Dense, true));
        assert_eq!((config.bodies, config.vary["arm_density"]), (3, [0.9, 1.0]));
        assert_eq!(bodies.goals(), [[0.1, 0.0, 1.0 / 3.0], [0.0, 1.0, 0.25]]);
        assert_eq!((world.num_envs, world.max_episode_steps), (Some(9), Some(7)));
        assert_eq!(world.task.physics_steps(), 50);

        // Many goals, bodies and muscles are reckoned with.
        let bytes = |pairs: &[(&str, Tensor)]| memory(&reaching(pairs).expect("world").0);
        let goals = doubles(vec![0.1; 3 * 60_000], &[60_000, 3]);
        assert!(bytes(&[("goals", goals)]) > bytes(&[]) + 24 * 58_000);
        assert!(bytes(&[("segments", integer(20))]) > bytes(&[]));
        let varied =
            [("vary.arm_density", doubles(vec![0.9, 1.0], &[2])), ("bodies", integer(256))];
        assert!(bytes(&varied) > 100 * size_of::<ArmParameters>() + bytes(&[]));
    }

    #[test]
    fn bad_settings_of_reaching_are_named() {
        let scalar = |value: f64| doubles(vec![value], &[]);
        for (name, tensor, expected) in [
            ("segments", integer(21), "segments = 21 is outside the allowed range [1, 20]"),
            ("segments", scalar(2.5), "segments: invalid type"),
            ("max_force", scalar(0.0), "max_force = 0 is outside the allowed range (0, 100]"),
            ("activation_time", scalar(-1.0), "activation_time = -1 is outside"),
            ("distance_threshold", scalar(2.0), "distance_threshold = 2 is outside"),
            ("reward_type", text("rich"), "reward_type: unknown variant `rich`"),
            ("observe_rates", integer(1), "observe_rates: invalid type"),
            ("control_period", scalar(0.0505), "control_period = 0.0505"),
            ("goals", doubles(vec![0.0, 0.0, 11.0], &[1, 3]), "goals[0, 2] = 11 is outside"),
            ("goals", doubles(vec![0.0; 4], &[2, 2]), "goals[0]: invalid length 2"),
            ("goals", doubles(vec![0.0; 3], &[3]), "goals[0]: invalid type"),
            ("goals", doubles(Vec::new(), &[0, 3]), "goals has shape (0, 3)"),
            ("target", text("lissajous"), "unknown setting \"target\" with task = \"reach\""),
            ("action_noise", scalar(1.0), "but of \"limit_cycle\"; known are activation_time"),
            ("colour", integer(1), "unknown setting \"colour\"; known are activation_time, arm"),
            ("autoreset_mode", text("disabled"), "autoreset_mode is a batch's"),
            ("arm.compartments", integer(200), "arm.compartments = 200"),
        ] {
            let message = reaching(&[(name, tensor)]).expect_err(name).message;
            assert!(message.contains(expected), "{name}: {message}");
        }
        for (task, expected) in [
            (
                text("grasp"),
                "task = \"grasp\" is outside the allowed range of \"limit_cycle\", \"reach\"",
            ),
            (integer(1), "task = 1 is outside the allowed range of"),
        ] {
            let message = settings(&[("task", task)]).expect_err(expected).message;
            assert!(message.contains(expected), "{message}");
        }
        let message = settings(&[("segments", integer(5))]).expect_err("no task").message;
        assert!(message.contains("with task = \"limit_cycle\", but of \"reach\""), "{message}");
        let much = [("control_period", scalar(10.0)), ("num_envs", integer(1024))];
        let refusal = reaching(&much).expect_err("too much");
        assert_eq!(refusal.code, tonic::Code::ResourceExhausted);
    }
}
