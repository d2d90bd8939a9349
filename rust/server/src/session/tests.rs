//! Streams without a network: what is answered, what is freed, what nobody can break.

#![allow(clippy::panic)]

use std::collections::BTreeMap;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::atomic::{AtomicU64 as Number, Ordering};
use std::time::Duration;

use octoarm_protocol::CreateWorldRequest;
use octoarm_protocol::tensor::{
    BoolArray, DoubleArray, FloatArray, Int8Array, Int64Array, Payload, ProtoArray, StringArray,
    Uint64Array,
};
use octoarm_protocol::{EnvironmentStateType as State, Tensor};
use proptest::collection::{btree_map, vec};
use proptest::prelude::*;
use tokio::runtime::Runtime;

use super::*;
use crate::metrics::Metrics;
use crate::settings::Limits;
use crate::tensor::{doubles, integer, text};

fn limits() -> Limits {
    Limits { max_physics_steps: 20_000, max_num_envs: 40, max_worlds: 64, ..Limits::default() }
}

fn sessions(limits: Limits) -> Arc<Sessions> {
    Sessions::new(limits, Metrics::new(), CancellationToken::new(), 2).expect("threads")
}

/// A stream over a connection of its own.
fn open(sessions: &Arc<Sessions>) -> Session {
    static CONNECTIONS: Number = Number::new(1);
    let connection = CONNECTIONS.fetch_add(1, Ordering::Relaxed);
    let address = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 1);
    Session::new(Arc::clone(sessions), Peer::new(connection, address), None)
}

async fn ask(
    session: &mut Session,
    request: Request,
) -> Result<Response, octoarm_protocol::Status> {
    let answer = session.answer(EnvironmentRequest { payload: Some(request) }).await;
    match answer.payload.expect("an answer holds something") {
        Response::Error(status) => Err(status),
        payload => Ok(payload),
    }
}

async fn code(session: &mut Session, request: Request) -> Code {
    match ask(session, request).await {
        Ok(_) => Code::Ok,
        Err(status) => Code::from_i32(status.code),
    }
}

fn settings(pairs: &[(&str, Tensor)]) -> BTreeMap<String, Tensor> {
    pairs.iter().map(|(name, tensor)| ((*name).to_owned(), tensor.clone())).collect()
}

fn join_of(world_name: &str) -> Request {
    let world_name = world_name.to_owned();
    Request::JoinWorld(JoinWorldRequest { world_name, settings: BTreeMap::new() })
}

fn destroy_of(world_name: &str) -> Request {
    Request::DestroyWorld(DestroyWorldRequest { world_name: world_name.to_owned() })
}

fn reset_world_of(world_name: &str) -> Request {
    let world_name = world_name.to_owned();
    Request::ResetWorld(ResetWorldRequest { world_name, settings: BTreeMap::new() })
}

fn step_of(observations: &[u64]) -> Request {
    let requested_observations = observations.to_vec();
    Request::Step(StepRequest { actions: BTreeMap::new(), requested_observations })
}

async fn create(session: &mut Session, pairs: &[(&str, Tensor)]) -> String {
    let request = Request::CreateWorld(CreateWorldRequest { settings: settings(pairs) });
    match ask(session, request).await {
        Ok(Response::CreateWorld(world)) => world.world_name,
        other => panic!("{other:?}"),
    }
}

async fn state(session: &mut Session) -> State {
    match ask(session, step_of(&[])).await {
        Ok(Response::Step(step)) => step.state(),
        other => panic!("{other:?}"),
    }
}

fn run(test: impl Future<Output = ()>) {
    Runtime::new().expect("runtime").block_on(test);
}

/// Whether a reset waits for the stream's client.
fn awaited(session: &Session) -> bool {
    session.agent().is_ok_and(|agent| agent.world.awaited())
}

/// Waits until something holds, for a while.
async fn until(holds: impl Fn() -> bool) {
    for _ in 0..2000 {
        if holds() {
            return;
        }
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    panic!("it never came to hold");
}

#[test]
fn an_ended_stream_frees_what_it_made() {
    run(async {
        let sessions = sessions(limits());
        let mut session = open(&sessions);
        let world = create(&mut session, &[]).await;
        create(&mut session, &[("num_envs", integer(3))]).await;
        assert_eq!(code(&mut session, join_of(&world)).await, Code::Ok);
        assert_eq!((sessions.worlds.len(), sessions.metrics.worlds.get()), (2, 2));
        drop(session);
        assert_eq!((sessions.worlds.len(), sessions.metrics.worlds.get()), (0, 0));
        assert_eq!((sessions.metrics.streams.get(), sessions.len()), (0, 0));
    });
}

#[test]
fn a_world_takes_one_client_and_outlives_its_maker_with_it() {
    run(async {
        let sessions = sessions(limits());
        let (mut maker, mut other, mut third) = (open(&sessions), open(&sessions), open(&sessions));
        let world = create(&mut maker, &[]).await;
        assert_eq!(code(&mut other, join_of(&world)).await, Code::Ok);
        assert_eq!(code(&mut third, join_of(&world)).await, Code::FailedPrecondition);
        for session in [&mut maker, &mut other, &mut third] {
            assert_eq!(code(session, destroy_of(&world)).await, Code::FailedPrecondition);
        }
        drop(maker);
        assert_eq!(state(&mut other).await, State::Running);
        drop(other);
        assert_eq!(code(&mut third, join_of(&world)).await, Code::NotFound);
        assert_eq!(sessions.metrics.worlds.get(), 0);
    });
}

#[test]
fn who_leaves_can_join_again_and_begins_anew() {
    run(async {
        let sessions = sessions(limits());
        let mut session = open(&sessions);
        let world = create(&mut session, &[("seed", integer(1))]).await;
        assert_eq!(code(&mut session, step_of(&[])).await, Code::FailedPrecondition);
        assert_eq!(code(&mut session, join_of(&world)).await, Code::Ok);
        assert_eq!(code(&mut session, join_of(&world)).await, Code::FailedPrecondition);
        state(&mut session).await;
        for _ in 0..2 {
            let leave = Request::LeaveWorld(octoarm_protocol::LeaveWorldRequest {});
            assert_eq!(code(&mut session, leave).await, Code::Ok);
        }
        assert_eq!(code(&mut session, join_of(&world)).await, Code::Ok);
        // The first step begins an episode, for which an action does not matter.
        let bad = BTreeMap::from([(7, text("left"))]);
        let first = StepRequest { actions: bad, requested_observations: vec![] };
        assert_eq!(code(&mut session, Request::Step(first.clone())).await, Code::Ok);
        assert_eq!(code(&mut session, Request::Step(first)).await, Code::InvalidArgument);
    });
}

#[test]
fn a_world_that_reaches_is_made_in_parts_stepped_and_freed() {
    run(async {
        let sessions = sessions(limits());
        let mut session = open(&sessions);
        let world = create(
            &mut session,
            &[
                ("task", text("reach")),
                ("num_envs", integer(9)),
                ("bodies", integer(3)),
                ("vary.arm_density", doubles(vec![0.9, 1.0], &[2])),
                ("arm.compartments", integer(3)),
                ("segments", integer(2)),
                ("max_episode_steps", integer(2)),
            ],
        )
        .await;
        assert!(sessions.metrics.world_bytes.get() > 9 * 1024);
        assert_eq!(code(&mut session, join_of(&world)).await, Code::Ok);
        assert_eq!(state(&mut session).await, State::Running);
        let action = |value: f64, width: i32| {
            let action = doubles(vec![value; 9 * width as usize], &[9, width]);
            let actions = BTreeMap::from([(1, action)]);
            Request::Step(StepRequest { actions, requested_observations: vec![2, 10] })
        };
        for (wrong, width) in [(1.5, 10), (-0.5, 10), (f64::NAN, 10), (0.5, 9)] {
            assert_eq!(code(&mut session, action(wrong, width)).await, Code::InvalidArgument);
        }
        for truncated in [false, true, false] {
            let Ok(Response::Step(step)) = ask(&mut session, action(0.5, 10)).await else {
                panic!("a step")
            };
            assert_eq!(step.state(), State::Running);
            let Some(Payload::Bools(ends)) = &step.observations[&10].payload else {
                panic!("flags")
            };
            assert_eq!(ends.array, [truncated; 9]);
        }
        drop(session);
        assert_eq!((sessions.worlds.len(), sessions.metrics.world_bytes.get()), (0, 0));
    });
}

#[test]
fn a_reset_world_waits_for_the_client_that_has_joined() {
    run(async {
        let sessions = sessions(limits());
        let (mut maker, mut agent) = (open(&sessions), open(&sessions));
        let world = create(&mut maker, &[("seed", integer(1))]).await;
        assert_eq!(code(&mut maker, reset_world_of(&world)).await, Code::Ok);
        assert_eq!(code(&mut agent, join_of(&world)).await, Code::Ok);
        for _ in 0..3 {
            assert_eq!(state(&mut agent).await, State::Running);
        }
        let waiting = {
            let world = world.clone();
            tokio::spawn(async move { code(&mut maker, reset_world_of(&world)).await })
        };
        until(|| awaited(&agent)).await;
        assert!(!waiting.is_finished());
        // A request that is refused changes nothing.
        assert_eq!(code(&mut agent, step_of(&[99])).await, Code::InvalidArgument);
        assert!(!waiting.is_finished());
        assert_eq!(state(&mut agent).await, State::Interrupted);
        assert_eq!(waiting.await.expect("task"), Code::Ok);
        assert_eq!(state(&mut agent).await, State::Running);

        // A caller that has joined the world itself just goes on with the next episode.
        assert_eq!(code(&mut agent, reset_world_of(&world)).await, Code::Ok);
        assert_eq!(state(&mut agent).await, State::Running);

        // A client that leaves has seen the end too.
        let own = create(&mut agent, &[]).await;
        let mut owner = open(&sessions);
        assert_eq!(code(&mut owner, join_of(&own)).await, Code::Ok);
        assert_eq!(state(&mut owner).await, State::Running);
        let waiting = tokio::spawn(async move { code(&mut agent, reset_world_of(&own)).await });
        until(|| awaited(&owner)).await;
        drop(owner);
        assert_eq!(waiting.await.expect("task"), Code::Ok);
    });
}

/// A world whose step takes long enough to be computed elsewhere.
fn long_world() -> [(&'static str, Tensor); 2] {
    [("control_period", doubles(vec![1.0], &[])), ("num_envs", integer(16))]
}

#[test]
fn a_long_step_is_computed_elsewhere_and_ends_with_its_stream() {
    run(async {
        let sessions = sessions(Limits { max_physics_steps: 1_000_000, ..limits() });
        let mut session = open(&sessions);
        let world = create(&mut session, &long_world()).await;
        assert_eq!(code(&mut session, join_of(&world)).await, Code::Ok);
        assert_eq!(state(&mut session).await, State::Running);
        assert_eq!(state(&mut session).await, State::Running);
        // The step is begun, and the stream ends.
        let step = tokio::spawn(async move { state(&mut session).await });
        tokio::time::sleep(Duration::from_millis(2)).await;
        step.abort();
        until(|| sessions.metrics.worlds.get() == 0).await;
        assert_eq!(sessions.worlds.len(), 0);
    });
}

#[test]
fn a_world_whose_step_was_given_up_begins_anew() {
    run(async {
        let sessions = sessions(Limits { max_physics_steps: 1_000_000, ..limits() });
        let (mut maker, mut joined, mut heir) = (open(&sessions), open(&sessions), open(&sessions));
        let world = create(&mut maker, &long_world()).await;
        assert_eq!(code(&mut joined, join_of(&world)).await, Code::Ok);
        assert_eq!(state(&mut joined).await, State::Running);
        let step = tokio::spawn(async move { state(&mut joined).await });
        tokio::time::sleep(Duration::from_millis(2)).await;
        step.abort();
        until(|| sessions.metrics.streams.get() == 2).await;
        // The part that was being made may take a moment yet.
        while code(&mut heir, join_of(&world)).await != Code::Ok {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
        assert_eq!(state(&mut heir).await, State::Running);
        let before = sessions.metrics.steps.get();
        assert_eq!(state(&mut heir).await, State::Running);
        assert_eq!(sessions.metrics.steps.get() - before, 16);
    });
}

#[test]
fn streams_that_end_while_they_wait_for_their_turn_lose_no_world() {
    run(async {
        let sessions =
            sessions(Limits { max_physics_steps: 1_000_000, max_threads: 1, ..limits() });
        let mut steps = Vec::new();
        for _ in 0..6 {
            let mut session = open(&sessions);
            let world = create(&mut session, &long_world()).await;
            assert_eq!(code(&mut session, join_of(&world)).await, Code::Ok);
            assert_eq!(state(&mut session).await, State::Running);
            steps.push(session);
        }
        let steps: Vec<_> = steps
            .into_iter()
            .map(|mut session| tokio::spawn(async move { state(&mut session).await }))
            .collect();
        tokio::time::sleep(Duration::from_millis(5)).await;
        assert_eq!(sessions.metrics.worlds.get(), 6);
        steps.iter().for_each(tokio::task::JoinHandle::abort);
        until(|| sessions.metrics.worlds.get() == 0).await;
        assert_eq!((sessions.worlds.len(), sessions.len()), (0, 0));
    });
}

#[test]
fn a_world_that_a_panic_has_left_is_given_up() {
    run(async {
        let sessions = sessions(limits());
        let mut session = open(&sessions);
        let world = create(&mut session, &[]).await;
        assert_eq!(code(&mut session, join_of(&world)).await, Code::Ok);
        assert_eq!(state(&mut session).await, State::Running);
        let agent = session.agent().expect("joined");
        let work = move || {
            let _environment = agent.world.environment();
            panic!("while the environment is locked");
        };
        assert!(tokio::task::spawn_blocking(work).await.is_err());
        assert_eq!(code(&mut session, step_of(&[])).await, Code::Internal);
        assert_eq!((sessions.worlds.len(), sessions.metrics.worlds.get()), (0, 0));
        assert_eq!(code(&mut session, step_of(&[])).await, Code::FailedPrecondition);
        let world = create(&mut session, &[]).await;
        assert_eq!(code(&mut session, join_of(&world)).await, Code::Ok);
        assert_eq!(state(&mut session).await, State::Running);
    });
}

#[test]
fn two_clients_do_not_wait_for_each_other() {
    run(async {
        let sessions = sessions(limits());
        let (mut first, mut second) = (open(&sessions), open(&sessions));
        let one = create(&mut first, &[]).await;
        let two = create(&mut second, &[]).await;
        assert_eq!(code(&mut first, join_of(&one)).await, Code::Ok);
        assert_eq!(code(&mut second, join_of(&two)).await, Code::Ok);
        let waiting = {
            let two = two.clone();
            tokio::spawn(async move {
                let waited = code(&mut first, reset_world_of(&two)).await;
                (first, waited)
            })
        };
        until(|| awaited(&second)).await;
        assert_eq!(code(&mut second, reset_world_of(&one)).await, Code::FailedPrecondition);
        assert_eq!(state(&mut second).await, State::Running);
        let (mut first, waited) = waiting.await.expect("task");
        assert_eq!(waited, Code::Ok);
        // Who waits no longer can be waited for.
        let again = tokio::spawn(async move { code(&mut second, reset_world_of(&one)).await });
        until(|| awaited(&first)).await;
        state(&mut first).await;
        assert_eq!(again.await.expect("task"), Code::Ok);
        assert_eq!(sessions.worlds.len(), 1);
    });
}

#[test]
fn the_wish_of_who_has_gone_is_forgotten() {
    run(async {
        let sessions = sessions(limits());
        let (mut maker, mut agent) = (open(&sessions), open(&sessions));
        let world = create(&mut maker, &[]).await;
        assert_eq!(code(&mut agent, join_of(&world)).await, Code::Ok);
        assert_eq!(state(&mut agent).await, State::Running);
        let waiting = tokio::spawn(async move { code(&mut maker, reset_world_of(&world)).await });
        until(|| awaited(&agent)).await;
        waiting.abort();
        until(|| sessions.metrics.streams.get() == 1).await;
        assert_eq!(state(&mut agent).await, State::Running);
    });
}

#[test]
fn many_arms_count_by_their_size() {
    run(async {
        let sessions = sessions(Limits { max_arms: 10, ..limits() });
        let mut session = open(&sessions);
        let batch = |arms: i64, compartments: i64| {
            let pairs = [("num_envs", integer(arms)), ("arm.compartments", integer(compartments))];
            Request::CreateWorld(CreateWorldRequest { settings: settings(&pairs) })
        };
        assert_eq!(code(&mut session, batch(11, 3)).await, Code::ResourceExhausted);
        assert_eq!(code(&mut session, batch(6, 40)).await, Code::ResourceExhausted);
        assert_eq!(code(&mut session, batch(8, 3)).await, Code::Ok);
        assert_eq!(code(&mut session, batch(3, 3)).await, Code::ResourceExhausted);
        assert_eq!(code(&mut session, batch(2, 3)).await, Code::Ok);
    });
}

#[test]
fn idle_streams_lose_their_worlds_even_if_nobody_serves_them() {
    run(async {
        let sessions = sessions(Limits { idle_timeout: Duration::from_millis(20), ..limits() });
        let mut session = open(&sessions);
        let world = create(&mut session, &[]).await;
        assert_eq!(code(&mut session, join_of(&world)).await, Code::Ok);
        tokio::time::sleep(Duration::from_millis(30)).await;
        sessions.end_idle();
        assert!(session.idle().is_cancelled());
        assert_eq!((sessions.metrics.worlds.get(), sessions.metrics.idle.get()), (0, 1));
        sessions.end_idle();
        assert_eq!(sessions.metrics.idle.get(), 1);
    });
}

#[test]
fn limits_hold_and_places_come_back() {
    run(async {
        let few = Limits { max_worlds: 3, max_worlds_per_connection: 2, ..limits() };
        let sessions = sessions(few);
        let (mut first, mut second) = (open(&sessions), open(&sessions));
        let request = || Request::CreateWorld(CreateWorldRequest::default());
        let world = create(&mut first, &[]).await;
        create(&mut first, &[]).await;
        assert_eq!(code(&mut first, request()).await, Code::ResourceExhausted);
        create(&mut second, &[]).await;
        assert_eq!(code(&mut second, request()).await, Code::ResourceExhausted);
        // A world that cannot be made takes no place.
        assert_eq!(code(&mut first, destroy_of(&world)).await, Code::Ok);
        let bad = settings(&[("arm", text("inertial")), ("amplitude", doubles(vec![359.0], &[]))]);
        let bad = Request::CreateWorld(CreateWorldRequest { settings: bad });
        assert_eq!(code(&mut first, bad).await, Code::InvalidArgument);
        assert_eq!(code(&mut first, request()).await, Code::Ok);
    });
}

/// Any tensor, of a few elements.
fn any_tensor() -> impl Strategy<Value = Tensor> {
    let number = prop_oneof![
        any::<f64>(),
        Just(f64::NAN),
        Just(f64::INFINITY),
        (-3_i32..4).prop_map(f64::from),
    ];
    let payload = prop_oneof![
        vec(number, 0..6).prop_map(|array| Payload::Doubles(DoubleArray { array })),
        vec(any::<f32>(), 0..4).prop_map(|array| Payload::Floats(FloatArray { array })),
        vec(any::<i64>(), 0..4).prop_map(|array| Payload::Int64s(Int64Array { array })),
        vec(any::<u64>(), 0..4).prop_map(|array| Payload::Uint64s(Uint64Array { array })),
        vec(any::<u8>(), 0..4).prop_map(|array| Payload::Int8s(Int8Array { array })),
        vec(any::<bool>(), 0..4).prop_map(|array| Payload::Bools(BoolArray { array })),
        vec("(lissajous|servo|direct|\\PC{0,8})", 0..3)
            .prop_map(|array| Payload::Strings(StringArray { array })),
        Just(Payload::Protos(ProtoArray::default())),
    ];
    let size = prop_oneof![Just(-1), 0..4_i32, any::<i32>()];
    (proptest::option::of(payload), vec(size, 0..4))
        .prop_map(|(payload, shape)| Tensor { payload, shape })
}

fn any_settings() -> impl Strategy<Value = BTreeMap<String, Tensor>> {
    let name = "(target|amplitude|control_period|seed|phase|num_envs|threads|max_episode_steps|\
                actuator|arm|arm\\.compartments|arm\\.timestep|arm\\.gravity|goal|goals|segments|\\PC{0,6})";
    let task = prop_oneof![Just(None), Just(Some("reach"))];
    (btree_map(name, any_tensor(), 0..3), task).prop_map(|(mut settings, task)| {
        if let Some(task) = task {
            settings.insert("task".to_owned(), text(task));
        }
        settings
    })
}

/// Any request; worlds are named `*`, which stands for one that there is.
fn any_request() -> impl Strategy<Value = Request> {
    let name = "(\\*|\\*|\\PC{0,6})";
    prop_oneof![
        any_settings().prop_map(|settings| Request::CreateWorld(CreateWorldRequest { settings })),
        (name, any_settings()).prop_map(|(world_name, settings)| {
            Request::JoinWorld(JoinWorldRequest { world_name, settings })
        }),
        name.prop_map(|world_name| join_of(&world_name)),
        (btree_map(0..3_u64, any_tensor(), 0..3), vec(0..13_u64, 0..13)).prop_map(
            |(actions, requested_observations)| {
                Request::Step(StepRequest { actions, requested_observations })
            }
        ),
        Just(step_of(&[1, 2, 3, 4, 5, 6, 7, 8, 9, 10])),
        any_settings().prop_map(|settings| Request::Reset(ResetRequest { settings })),
        (name, any_settings()).prop_map(|(world_name, settings)| {
            Request::ResetWorld(ResetWorldRequest { world_name, settings })
        }),
        Just(Request::LeaveWorld(octoarm_protocol::LeaveWorldRequest {})),
        name.prop_map(|world_name| destroy_of(&world_name)),
        (
            "(type\\.googleapis\\.com/dm_env_rpc\\.v1\\.extensions\\.properties\\.PropertyRequest\
             |\\PC{0,8})",
            vec(any::<u8>(), 0..20)
        )
            .prop_map(|(type_url, value)| Request::Extension(prost_types::Any { type_url, value })),
    ]
}

fn finite(tensor: &Tensor) -> bool {
    match &tensor.payload {
        Some(Payload::Doubles(list)) => list.array.iter().all(|number| number.is_finite()),
        _ => true,
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn every_request_has_its_answer(requests in vec(any_request(), 1..30)) {
        let sessions = sessions(limits());
        run(async {
            let mut session = open(&sessions);
            let mut world = create(&mut session, &[]).await;
            for mut request in requests {
                let names = match &mut request {
                    Request::JoinWorld(request) => Some(&mut request.world_name),
                    Request::ResetWorld(request) => Some(&mut request.world_name),
                    Request::DestroyWorld(request) => Some(&mut request.world_name),
                    _ => None,
                };
                if let Some(name) = names && name == "*" {
                    name.clone_from(&world);
                }
                let kind = std::mem::discriminant(&request);
                match ask(&mut session, request.clone()).await {
                    Err(status) => {
                        let code = Code::from_i32(status.code);
                        assert!(!matches!(code, Code::Ok | Code::Internal | Code::Unknown), "{status:?}");
                        assert!(!status.message.is_empty());
                    }
                    Ok(Response::CreateWorld(answer)) => world = answer.world_name,
                    Ok(Response::Step(answer)) => {
                        assert!(matches!(request, Request::Step(_)), "{kind:?}");
                        assert!(answer.observations.values().all(finite), "{answer:?}");
                    }
                    Ok(_) => {}
                }
            }
        });
        prop_assert_eq!((sessions.worlds.len(), sessions.metrics.worlds.get()), (0, 0));
    }
}
