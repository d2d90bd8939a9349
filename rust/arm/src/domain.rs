//! Where the model ends.
//!
//! Nothing in the springs stops a compartment from folding through itself: under violent base motion
//! a strut shrinks to nothing or a joint folds right back, the planes pass through each other, and the
//! state diverges. Smaller steps fail too; it is physics out of domain. So every step is checked
//! against these limits, and a step that would leave them is refused with a [`DomainError`]; the arm
//! keeps its last valid state. The limits are wide: wild swings come back from bends of 126 degrees
//! (the quadratic cycle of 130 degrees on a directly driven base), while a strut below a tenth of its
//! height was never seen to come back.

use crate::error::{DomainError, Limit};
use crate::kernel::Block;
use crate::parameters::ArmParameters;

/// Largest |α| and |β| of a universal joint \[rad\]: 150 degrees.
pub const BEND_ANGLE: f64 = 5.0 * std::f64::consts::FRAC_PI_6;
/// Strut height relative to its rest height.
pub const HEIGHT: (f64, f64) = (0.1, 3.0);
/// Radius relative to its rest value.
pub const RADIUS: (f64, f64) = (0.2, 3.0);
/// Longitudinal spring length relative to its rest length.
pub const SPRING_LENGTH: (f64, f64) = (0.05, 3.0);

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
        for k in 0..crate::state::COORDINATES {
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

/// Bounds of a chunk's rows, so that the check in the loop is straight-line comparisons.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bounds {
    pub(crate) height: (f64, f64),
    pub(crate) length: (f64, f64),
}

impl Bounds {
    pub(crate) fn new(parameters: &ArmParameters) -> Self {
        let height = parameters.rest_height();
        let length = parameters.rest_length;
        Self {
            height: (HEIGHT.0 * height, HEIGHT.1 * height),
            length: (SPRING_LENGTH.0 * length, SPRING_LENGTH.1 * length),
        }
    }
}

/// Whether every slot of a chunk is inside the domain. May refuse a value within rounding of a limit
/// that [`find_failure`] would pass; the step then counts as inside.
#[inline(always)]
pub(crate) fn chunk_is_inside(
    bounds: &Bounds,
    coordinates: &Block,
    rates: &Block,
    rest_radius: &[f64; crate::kernel::WIDTH],
    lengths: &[[f64; crate::kernel::WIDTH]; 4],
) -> bool {
    let mut inside = true;
    for k in 0..crate::kernel::WIDTH {
        let q = &coordinates.0;
        inside &= q[0][k] >= bounds.height.0;
        inside &= q[0][k] <= bounds.height.1;
        inside &= q[1][k].abs() <= BEND_ANGLE;
        inside &= q[2][k].abs() <= BEND_ANGLE;
        let (low, high) = (RADIUS.0 * rest_radius[k], RADIUS.1 * rest_radius[k]);
        for i in 0..4 {
            inside &= q[3 + i][k] >= low;
            inside &= q[3 + i][k] <= high;
            inside &= lengths[i][k] >= bounds.length.0;
            inside &= lengths[i][k] <= bounds.length.1;
        }
        for c in 0..crate::state::COORDINATES {
            inside &= rates.0[c][k].abs() <= f64::MAX;
        }
    }
    inside
}
