//! Up to eight arms that step together.

use std::sync::Arc;

use crate::arm::Arm;
use crate::base::Actuator;
use crate::domain::DomainError;
use crate::error::ParameterError;
use crate::kernel::WIDTH;
use crate::lanes::Lanes;
use crate::parameters::ArmParameters;
use crate::runge_kutta::Integrator;
use crate::state::ArmState;

/// Up to [`ArmLanes::WIDTH`] arms that step together, one in each lane of the vector registers: many
/// times the speed of one [`Arm`], and every arm has the very bits that it would have alone,
/// whatever its neighbours do.
///
/// ```
/// use octoarm_arm::{Actuator, Arm, ArmLanes, ArmParameters};
/// let mut arm = Arm::new(ArmParameters::default(), Actuator::Servo)?;
/// let mut lanes = ArmLanes::new(&[&arm, &arm, &arm])?;
/// let commands = [[10.0, 0.0]; ArmLanes::WIDTH];
/// assert!(lanes.step(&commands, &[true; ArmLanes::WIDTH]));
/// arm.step([10.0, 0.0])?;
/// assert_eq!(lanes.state(2), arm.state());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct ArmLanes {
    lanes: Width,
    count: usize,
}

/// One arm alone takes the kernel of one arm: a quarter of the time of eight lanes, the same bits.
#[derive(Clone, Debug)]
enum Width {
    One(Box<Lanes<1>>),
    All(Box<Lanes<WIDTH>>),
}

/// The same expression for either width.
macro_rules! of {
    ($group:expr, $lanes:ident => $expression:expr) => {
        match $group {
            Width::One($lanes) => $expression,
            Width::All($lanes) => $expression,
        }
    };
}

impl ArmLanes {
    /// Number of lanes.
    pub const WIDTH: usize = WIDTH;

    /// Takes copies of arms, their states and muscle inputs; the instruction set is the first's.
    /// Parameters and actuators may differ from arm to arm.
    ///
    /// # Errors
    /// [`ParameterError::OutOfRange`] for no arms, more than [`ArmLanes::WIDTH`], or different
    /// numbers of compartments.
    pub fn new(arms: &[&Arm]) -> Result<Self, ParameterError> {
        let refuse = |name: &str, value: usize, range: String| {
            Err(ParameterError::out_of_range(name, value, range))
        };
        let Some(first) = arms.first().filter(|_| arms.len() <= WIDTH) else {
            return refuse("arms", arms.len(), format!("[1, {WIDTH}] arms"));
        };
        let compartments = first.parameters().compartments;
        for arm in arms {
            if arm.parameters().compartments != compartments {
                let range = format!("of one number for all arms, here {compartments}");
                return refuse("compartments", arm.parameters().compartments, range);
            }
        }
        let lanes = match arms {
            [arm] => Width::One(Box::new(arm.lane().clone())),
            _ => Width::All(Box::new(side_by_side(arms, first))),
        };
        Ok(Self { lanes, count: arms.len() })
    }

    /// Memory of `WIDTH` arms with this many compartments \[bytes\], rounded up.
    #[must_use]
    pub fn bytes(compartments: usize) -> usize {
        size_of::<Self>() + Integrator::<WIDTH>::bytes(compartments)
    }

    /// Number of arms.
    #[must_use]
    #[allow(clippy::len_without_is_empty)]
    pub fn len(&self) -> usize {
        self.count
    }

    /// An arm's parameters.
    #[must_use]
    pub fn parameters(&self, lane: usize) -> &ArmParameters {
        of!(&self.lanes, lanes => lanes.parameters(lane))
    }

    /// How an arm's base follows its command.
    #[must_use]
    pub fn actuator(&self, lane: usize) -> Actuator {
        of!(&self.lanes, lanes => lanes.actuator(lane))
    }

    /// Number of observed spring lengths of an arm.
    #[must_use]
    pub fn observation_len(&self) -> usize {
        of!(&self.lanes, lanes => lanes.observation_len())
    }

    /// An arm's complete state.
    #[must_use]
    pub fn state(&self, lane: usize) -> ArmState {
        of!(&self.lanes, lanes => lanes.state(lane))
    }

    /// Restores an arm's state exactly.
    ///
    /// # Errors
    /// As [`Arm::set_state`]; the arm is then unchanged.
    pub fn set_state(&mut self, lane: usize, state: &ArmState) -> Result<(), ParameterError> {
        of!(&mut self.lanes, lanes => lanes.set_state(lane, state))
    }

    /// Puts arms into states that these very bodies have been in, without checks.
    pub fn restore(&mut self, states: &[(usize, &ArmState)]) {
        of!(&mut self.lanes, lanes => lanes.restore_many(states));
    }

    /// Puts other arms' bodies into lanes, in states that these very bodies have been in, without checks;
    /// all must have as many compartments as those here.
    ///
    /// # Panics
    /// If an arm has another number of compartments.
    pub fn place(&mut self, arms: &[(usize, &Arm, &ArmState)]) {
        let width = self.observation_len();
        assert!(
            arms.iter().all(|(_, arm, _)| arm.observation_len() == width),
            "lanes of one shape"
        );
        for (lane, arm, _) in arms {
            of!(&mut self.lanes, lanes => lanes.set_body(*lane, arm.lane()));
        }
        let states: Vec<_> = arms.iter().map(|(lane, _, state)| (*lane, *state)).collect();
        self.restore(&states);
    }

    /// Sets an arm's muscle inputs ξ_c and δ_c \[N\], as [`Arm::set_muscles`].
    ///
    /// # Errors
    /// As [`Arm::set_muscles`]; the arm is then unchanged.
    pub fn set_muscles(
        &mut self,
        lane: usize,
        longitudinal: &[f64],
        transverse: &[f64],
    ) -> Result<(), ParameterError> {
        of!(&mut self.lanes, lanes => lanes.set_muscles(lane, longitudinal, transverse))
    }

    /// An arm's muscle inputs ξ_c and δ_c \[N\], in observation order.
    #[must_use]
    pub fn muscles(&self, lane: usize) -> (Vec<f64>, Vec<f64>) {
        of!(&self.lanes, lanes => lanes.muscles(lane))
    }

    /// The base angles θ, φ of an arm \[degrees\].
    #[must_use]
    pub fn base_degrees(&self, lane: usize) -> [f64; 2] {
        let [theta, phi, _, _] = of!(&self.lanes, lanes => lanes.base(lane));
        [theta.to_degrees(), phi.to_degrees()]
    }

    /// Writes an arm's spring lengths \[m\], index 4 (j − 1) + (i − 1).
    ///
    /// # Panics
    /// If `out` is shorter than [`ArmLanes::observation_len`].
    pub fn lengths_into(&self, lane: usize, out: &mut [f64]) {
        of!(&self.lanes, lanes => lanes.lengths_into(lane, out));
    }

    /// One physics step of the active arms under their commands θ, φ \[degrees\]; the others wait.
    /// Lanes without an arm never step.
    ///
    /// Returns whether every active arm made its step. One whose step would leave the domain keeps
    /// its state, [`ArmLanes::failure`] says why, and the others are not touched by it.
    #[must_use]
    pub fn step(&mut self, commands: &[[f64; 2]; WIDTH], active: &[bool; WIDTH]) -> bool {
        let mut active = *active;
        active[self.count..].fill(false);
        match &mut self.lanes {
            Width::One(lane) => lane.step(&[commands[0]], &[active[0]]),
            Width::All(lanes) => lanes.step(commands, &active),
        }
    }

    /// Why an arm was refused in the last step that not all made; none if it made it.
    #[must_use]
    pub fn failure(&self, lane: usize) -> Option<DomainError> {
        of!(&self.lanes, lanes => lanes.failure(lane))
    }
}

/// Copies of arms in the lanes; those without an arm hold another copy of the first, which never
/// steps.
fn side_by_side(arms: &[&Arm], first: &Arm) -> Lanes<WIDTH> {
    let arm = |lane: usize| arms.get(lane).unwrap_or(&first).lane();
    let mut lanes = Lanes::new(
        std::array::from_fn(|lane| Arc::clone(arm(lane).parameters(0))),
        std::array::from_fn(|lane| arm(lane).actuator(0)),
        first.lane().instructions,
    );
    let states: [ArmState; WIDTH] = std::array::from_fn(|lane| arm(lane).state(0));
    let states: Vec<(usize, &ArmState)> = states.iter().enumerate().collect();
    lanes.restore_many(&states);
    lanes
}
