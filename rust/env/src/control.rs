//! From one action to the next: what the base is commanded in between.

use octoarm_arm::{Actuator, Arm, ArmLanes, DomainError, ParameterError};

const WIDTH: usize = ArmLanes::WIDTH;

/// The command \[degrees\] of physics step `step` (counted from 1) of the `steps` in a control period:
/// a servo takes the command as it is; a base driven `direct` moves there from `start` at constant
/// speed.
#[must_use]
pub fn command_at(
    actuator: Actuator,
    start: [f64; 2],
    command: [f64; 2],
    step: u32,
    steps: u32,
) -> [f64; 2] {
    match actuator {
        Actuator::Servo => command,
        Actuator::Direct if step == steps => command,
        Actuator::Direct => {
            let share = f64::from(step) / f64::from(steps);
            [0, 1].map(|axis| start[axis] + share * (command[axis] - start[axis]))
        }
    }
}

/// Moves the arm through one control period under a command in degrees ([`command_at`]).
///
/// Gives the reason if the arm would leave its domain; it then is in its last valid state.
///
/// # Errors
/// Those of `before_each` physics step, with the arm on its way.
pub(crate) fn control_step(
    arm: &mut Arm,
    command: [f64; 2],
    physics_steps: u32,
    before_each: impl Fn() -> Result<(), ParameterError>,
) -> Result<Option<DomainError>, ParameterError> {
    let (actuator, start) = (arm.actuator(), arm.base_degrees());
    for step in 1..=physics_steps {
        before_each()?;
        if let Err(failure) = arm.step(command_at(actuator, start, command, step, physics_steps)) {
            return Ok(Some(failure));
        }
    }
    Ok(None)
}

/// [`control_step`] of several arms: each lane makes its number of physics steps, which is 0 for one
/// that stands still, and `before_each` is told of every one. Says which lanes did not come to the end of
/// theirs, and why.
pub(crate) fn control_step_of_lanes(
    lanes: &mut ArmLanes,
    goals: &[[f64; 2]; WIDTH],
    physics_steps: &[u32; WIDTH],
    mut before_each: impl FnMut(&mut ArmLanes, usize),
) -> [Option<DomainError>; WIDTH] {
    let mut failures = [None; WIDTH];
    let arms = lanes.len();
    let starts: [[f64; 2]; WIDTH] =
        std::array::from_fn(|lane| lanes.base_degrees(lane.min(arms - 1)));
    let actuators: [Actuator; WIDTH] =
        std::array::from_fn(|lane| lanes.actuator(lane.min(arms - 1)));
    let mut commands = [[0.0; 2]; WIDTH];
    let mut moves = [false; WIDTH];
    for step in 1..=*physics_steps.iter().max().unwrap_or(&0) {
        for lane in 0..arms {
            let steps = physics_steps[lane];
            moves[lane] = step <= steps && failures[lane].is_none();
            if moves[lane] {
                commands[lane] =
                    command_at(actuators[lane], starts[lane], goals[lane], step, steps);
                before_each(lanes, lane);
            }
        }
        if !lanes.step(&commands, &moves) {
            for lane in 0..arms {
                // A lane that has failed before does not move any more.
                if moves[lane] {
                    failures[lane] = lanes.failure(lane);
                }
            }
        }
    }
    failures
}
