//! Reaching with muscles: what is refused, what is kept, and that neighbours change nothing.

use octoarm_arm::{Actuator, Arm};
use octoarm_env::{Autoreset, BatchState, EpisodeBatch, MUSCLES, Reach, ReachConfig, ReachState};

const GOALS: [[f64; 3]; 2] = [[0.1, 0.0, 0.35], [0.0, -0.1, 0.35]];

fn batch(text: &str, count: usize, threads: usize) -> EpisodeBatch<Reach> {
    let config = ReachConfig::from_json(text).expect("settings");
    let goals = GOALS.to_vec();
    EpisodeBatch::reaching(config, goals, count, Some(6), Autoreset::NextStep, Some(threads))
        .expect("batch")
}

fn seeds(count: u64) -> Vec<Option<u64>> {
    (0..count).map(Some).collect()
}

/// Actions that differ from arm to arm and step to step.
fn actions(count: usize, muscles: usize, step: usize) -> Vec<Vec<f64>> {
    let entry = |arm: usize, muscle: usize| ((arm + 3 * muscle + 7 * step) % 11) as f64 / 10.0;
    (0..count).map(|arm| (0..muscles).map(|muscle| entry(arm, muscle)).collect()).collect()
}

#[test]
fn bad_settings_are_named() {
    for (text, expected) in [
        (r#"{"segments": 0}"#, "segments = 0"),
        (r#"{"segments": 21}"#, "segments = 21"),
        (r#"{"max_force": 0.0}"#, "max_force = 0"),
        (r#"{"activation_time": -0.1}"#, "activation_time = -0.1"),
        (r#"{"distance_threshold": 1.5}"#, "distance_threshold = 1.5"),
        (r#"{"control_period": 0.0505}"#, "control_period = 0.0505"),
        (r#"{"reward_type": "rich"}"#, "reward_type"),
        (r#"{"bodies": 2}"#, "bodies = 2"),
        (r#"{"dropout": 81}"#, "dropout = 81"),
        (r#"{"colour": 1}"#, "colour"),
    ] {
        let found = ReachConfig::from_json(text).and_then(|config| {
            let goals = GOALS.to_vec();
            EpisodeBatch::reaching(config, goals, 1, None, Autoreset::Disabled, None)
        });
        let message = found.expect_err(text).to_string();
        assert!(message.contains(expected), "{text}: {message}");
    }
    let goals = |goals: Vec<[f64; 3]>, count| {
        let config = ReachConfig::default();
        EpisodeBatch::reaching(config, goals, count, None, Autoreset::Disabled, None)
            .expect_err("bad")
            .to_string()
    };
    assert!(goals(Vec::new(), 1).contains("goals"));
    assert!(goals(vec![[0.0, f64::NAN, 0.0]], 1).contains("goals[0, 1]"));
    assert!(goals(GOALS.to_vec(), 0).contains("num_envs = 0"));
}

#[test]
fn neighbours_and_threads_change_nothing() {
    let text = r#"{"observe_rates": true, "length_noise": 1e-5, "delay": 1, "bodies": 3,
                   "vary": {"arm_density": [0.9, 1.0]}}"#;
    let (mut alone, mut beside) = (batch(text, 1, 1), batch(text, 11, 3));
    alone.reset(None, &seeds(1), None).expect("reset");
    beside.reset(None, &seeds(11), None).expect("reset");
    let width = alone.observation_len();
    assert_eq!(width, 160);
    for step in 0..9 {
        let moves = actions(11, 25, step);
        let one = alone.step(&moves[..1]).expect("step");
        let many = beside.step(&moves).expect("step");
        assert_eq!(one.observations, many.observations[..width]);
        assert_eq!(one.outcomes[0], many.outcomes[0]);
        assert_eq!(alone.activations(0), beside.activations(0));
    }
    assert_eq!(alone.elapsed(), [2]);
}

#[test]
fn a_step_in_parts_is_the_same_step() {
    let (mut whole, mut parts) = (batch("{}", 20, 2), batch("{}", 20, 2));
    whole.reset(None, &seeds(20), None).expect("reset");
    parts.reset(None, &seeds(20), None).expect("reset");
    let moves = actions(20, 25, 0);
    let at_once = whole.step(&moves).expect("step");
    let mut step = parts.begin_step(&moves).expect("step");
    while !parts.advance_step(&mut step, 1) {}
    assert_eq!(step.finish().observations, at_once.observations);
}

#[test]
fn a_saved_batch_goes_on() {
    let text = r#"{"observe_rates": true, "delay": 2, "segments": 3}"#;
    let (mut batch, mut other) = (batch(text, 3, 1), batch(text, 3, 1));
    batch.reset(None, &seeds(3), None).expect("reset");
    batch.step(&actions(3, 15, 0)).expect("step");
    let saved = serde_json::to_string(&batch.state()).expect("json");
    let state: BatchState<ReachState> = serde_json::from_str(&saved).expect("json");
    other.set_state(&state).expect("state");
    assert_eq!(other.shown(), batch.shown());
    for step in 1..4 {
        let moves = actions(3, 15, step);
        let (found, expected) = (other.step(&moves), batch.step(&moves));
        assert_eq!(found.expect("step").observations, expected.expect("step").observations);
    }
    for (from, to) in [
        (r#""activation":["#, r#""activation":[7.0,"#),
        (r#""goal":[0."#, r#""goal":[99."#),
        (r#""body":0"#, r#""body":1"#),
        (r#""seen":["#, r#""seen":[0.02,"#),
    ] {
        assert!(saved.contains(from), "{from}");
        let bad: BatchState<ReachState> =
            serde_json::from_str(&saved.replace(from, to)).expect("json");
        let before = other.state();
        other.set_state(&bad).expect_err(to);
        assert_eq!(other.state(), before);
    }
}

#[test]
fn actions_and_goals_that_cannot_be_are_refused() {
    let mut batch = batch("{}", 2, 1);
    let muscles = 5 * MUSCLES;
    batch.step(&actions(2, muscles, 0)).expect_err("no episode runs");
    let far = batch.reset(None, &seeds(2), Some([0.0, 11.0, 0.0])).expect_err("too far");
    assert!(far.to_string().contains("goal[1] = 11"), "{far}");
    let reset = batch.reset(None, &seeds(2), Some([0.0, 0.0, 0.3])).expect("reset");
    assert!(reset.outcomes.iter().flatten().all(|outcome| outcome.goal == [0.0, 0.0, 0.3]));
    for bad in [-0.1, 1.1, f64::NAN] {
        let mut moves = actions(2, muscles, 0);
        moves[1][4] = bad;
        let error = batch.step(&moves).expect_err("bad action").to_string();
        assert!(error.contains("actions[1, 4]"), "{error}");
    }
    assert_eq!(batch.elapsed(), [0, 0]);
    // What rounding in single precision adds is taken for the bound.
    let mut moves = actions(2, muscles, 0);
    moves[0][0] = 1.0 + 1e-7;
    moves[1][0] = -1e-7;
    batch.step(&moves).expect("step");
}

/// In water, where nothing weighs, all that a slack arm can do is to lose energy.
#[test]
fn slack_muscles_give_no_energy() {
    let text = r#"{"arm": {"gravity": [0.0, 0.0, 0.0]}}"#;
    let config = ReachConfig::from_json(text).expect("settings");
    let mut arm = Arm::new(config.arm.clone(), Actuator::Direct).expect("arm");
    let goals = GOALS.to_vec();
    let mut batch =
        EpisodeBatch::reaching(config, goals, 1, None, Autoreset::Disabled, None).expect("batch");
    batch.reset(None, &seeds(1), None).expect("reset");
    let mut energy = |batch: &EpisodeBatch<Reach>| {
        arm.set_state(&batch.arms().state(0)).expect("state");
        arm.energy().kinetic + arm.energy().elastic
    };
    for step in 0..6 {
        batch.step(&actions(1, 25, step)).expect("step");
    }
    let active = energy(&batch);
    assert!(active > 1e-4, "{active}");
    // After two seconds an activation is what it was times 2e-9.
    for _ in 0..40 {
        batch.step(&[vec![0.0; 25]]).expect("step");
    }
    let mut before = energy(&batch);
    assert!(before < active);
    for _ in 0..20 {
        batch.step(&[vec![0.0; 25]]).expect("step");
        let now = energy(&batch);
        assert!(now < before, "{now} after {before}");
        before = now;
    }
}

#[test]
fn an_action_of_another_length_is_refused() {
    let mut batch = batch("{}", 1, 1);
    batch.reset(None, &seeds(1), None).expect("reset");
    let error = batch.step(&[vec![0.5; 24]]).expect_err("too short").to_string();
    assert!(error.contains("actions[0]") && error.contains("(25,)"), "{error}");
}
