//! Where the model ends.
//!
//! Nothing in the springs stops a compartment from folding through itself: under violent base motion
//! a strut shrinks to nothing or a joint folds right back, the planes pass through each other, and the
//! state diverges. Smaller steps fail too; it is physics out of domain. So every step is checked
//! against these limits, and a step that would leave them is refused with a [`DomainError`]; the arm
//! keeps its last valid state. The limits are wide: wild swings come back from bends of 126 degrees
//! (the quadratic cycle of 130 degrees on a directly driven base), while a strut below a tenth of its
//! height was never seen to come back.

use crate::kernel::{Block, Lengths, Row, WIDTH, lane_row, set_lane};
use crate::parameters::ArmParameters;
use crate::state::COORDINATES;

/// Largest |α| and |β| of a universal joint \[rad\]: 150 degrees.
pub const BEND_ANGLE: f64 = 5.0 * std::f64::consts::FRAC_PI_6;
/// Allowed strut height relative to its rest height.
pub const HEIGHT: (f64, f64) = (0.1, 3.0);
/// Allowed radius relative to its rest value.
pub const RADIUS: (f64, f64) = (0.2, 3.0);
/// Allowed length of a longitudinal spring relative to its rest length.
pub const SPRING_LENGTH: (f64, f64) = (0.05, 3.0);

/// The limits within which the model speaks of a soft arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Limit {
    /// A universal joint's angle |α| or |β| \[rad\].
    BendAngle,
    /// A strut's height relative to its rest height.
    Height,
    /// A radius relative to its rest value.
    Radius,
    /// A longitudinal spring's length relative to its rest length.
    SpringLength,
    /// A coordinate or rate that is not a finite number.
    NotFinite,
}

impl Limit {
    /// The limit's name as it appears in messages and in `info["failure"]`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::BendAngle => "bend_angle",
            Self::Height => "height",
            Self::Radius => "radius",
            Self::SpringLength => "spring_length",
            Self::NotFinite => "not_finite",
        }
    }
}

/// The arm has left the domain in which the model describes it. The arm keeps its last valid state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DomainError {
    /// Limit that was passed.
    pub limit: Limit,
    /// Compartment, counted from 1 at the base.
    pub compartment: usize,
    /// Value that was found, relative to rest, or in radians for the bend angle.
    pub value: f64,
    /// Lower limit, in the unit of the value.
    pub low: f64,
    /// Upper limit, in the unit of the value.
    pub high: f64,
    /// Time since the last reset at which the failing step would have ended \[s\].
    pub time: f64,
}

impl std::fmt::Display for DomainError {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { limit, compartment, value, low, high, time } = self;
        write!(formatter, "the arm left its domain: ")?;
        match limit {
            Limit::NotFinite => {
                write!(formatter, "compartment {compartment} has no finite state")?;
            }
            _ => write!(
                formatter,
                "{} of compartment {compartment} is {value:.4}, allowed {low:.4} to {high:.4}",
                limit.name()
            )?,
        }
        write!(formatter, ", at t = {time:.4} s")
    }
}

impl std::error::Error for DomainError {}

/// Finds the first limit that the state passes, base to tip.
///
/// `coordinate(j, k)` and `rate(j, k)` give entry `k` of compartment `j`, `length(j, i)` the length of
/// its spring `i`; `time` is only reported.
pub(crate) fn find_failure(
    parameters: &ArmParameters,
    coordinate: impl Fn(usize, usize) -> f64,
    rate: impl Fn(usize, usize) -> f64,
    length: impl Fn(usize, usize) -> f64,
    time: f64,
) -> Option<DomainError> {
    let height = parameters.rest_height();
    for j in 0..parameters.compartments {
        let fail = |limit, value, (low, high)| {
            Some(DomainError { limit, compartment: j + 1, value, low, high, time })
        };
        for k in 0..COORDINATES {
            let value = coordinate(j, k) + rate(j, k);
            if !value.is_finite() {
                return fail(Limit::NotFinite, value, (f64::MIN, f64::MAX));
            }
        }
        for k in 1..3 {
            let value = coordinate(j, k);
            if value.abs() > BEND_ANGLE {
                return fail(Limit::BendAngle, value, (-BEND_ANGLE, BEND_ANGLE));
            }
        }
        let value = coordinate(j, 0) / height;
        if value < HEIGHT.0 || value > HEIGHT.1 {
            return fail(Limit::Height, value, HEIGHT);
        }
        for i in 0..4 {
            let value = coordinate(j, 3 + i) / parameters.rest_radius(j + 1);
            if value < RADIUS.0 || value > RADIUS.1 {
                return fail(Limit::Radius, value, RADIUS);
            }
        }
        for i in 0..4 {
            let value = length(j, i) / parameters.rest_length;
            if value < SPRING_LENGTH.0 || value > SPRING_LENGTH.1 {
                return fail(Limit::SpringLength, value, SPRING_LENGTH);
            }
        }
    }
    None
}

/// More than rounding makes of a squared length and its bounds, as a share: what the words of
/// [`find_failure`] would call outside must not pass as inside.
const ROUNDING: f64 = 1e-14;

/// Bounds of a chunk's rows, so that the check in the loop is straight-line comparisons.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(crate) struct Bounds {
    height: [Row; 2],
    /// Bounds of the squared length.
    length: [Row; 2],
}

impl Bounds {
    pub(crate) fn new<const L: usize>(arms: &[&ArmParameters; L]) -> Self {
        let row = |value| lane_row::<L>(arms, value);
        Self {
            height: [
                row(|arm| HEIGHT.0 * arm.rest_height()),
                row(|arm| HEIGHT.1 * arm.rest_height()),
            ],
            length: [
                row(|arm| (SPRING_LENGTH.0 * arm.rest_length).powi(2) * (1.0 + ROUNDING)),
                row(|arm| (SPRING_LENGTH.1 * arm.rest_length).powi(2) * (1.0 - ROUNDING)),
            ],
        }
    }
}

impl Bounds {
    /// Gives one of `L` lanes the bounds of an arm alone.
    pub(crate) fn set_lane<const L: usize>(&mut self, lane: usize, alone: &Self) {
        let Self { height, length } = self;
        let rows = height.iter_mut().zip(&alone.height).chain(length.iter_mut().zip(&alone.length));
        rows.for_each(|(row, alone)| set_lane::<L>(row, lane, alone));
    }
}

// `f64::min` and `max` would take more than one instruction: they pass a NaN over.
#[inline(always)]
fn smaller(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

#[inline(always)]
fn larger(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

/// Sets the slots of `outside` to 1 where the state is not inside the domain. May refuse a value
/// within rounding of a limit that [`find_failure`] would pass; the step then counts as inside.
#[inline(always)]
pub(crate) fn mark_outside(
    bounds: &Bounds,
    coordinates: &Block,
    rates: &Block,
    rest_radius: &Row,
    Lengths(lengths): &Lengths,
    outside: &mut Row,
) {
    let q = &coordinates.0;
    for k in 0..WIDTH {
        let bend = larger(q[1][k].abs(), q[2][k].abs());
        let thin = smaller(smaller(q[3][k], q[4][k]), smaller(q[5][k], q[6][k]));
        let thick = larger(larger(q[3][k], q[4][k]), larger(q[5][k], q[6][k]));
        let [one, two, three, four] = lengths;
        let short = smaller(smaller(one[k], two[k]), smaller(three[k], four[k]));
        let long = larger(larger(one[k], two[k]), larger(three[k], four[k]));
        // A NaN may hide from the comparisons above, not from this sum.
        let mut sum = 0.0;
        for row in 0..COORDINATES {
            sum += q[row][k].abs() + rates.0[row][k].abs();
        }
        let inside = (sum <= f64::MAX)
            & (bend <= BEND_ANGLE)
            & (q[0][k] >= bounds.height[0][k])
            & (q[0][k] <= bounds.height[1][k])
            & (thin >= RADIUS.0 * rest_radius[k])
            & (thick <= RADIUS.1 * rest_radius[k])
            & (short >= bounds.length[0][k])
            & (long <= bounds.length[1][k]);
        outside[k] = if inside { outside[k] } else { 1.0 };
    }
}
