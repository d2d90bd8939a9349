//! Gravity, buoyancy, drag and lift on a compartment (Eqs. 9–15), and its volume.
//!
//! In the frame of the compartment's floor the strut is the z-axis, so the angle of incidence is that
//! between the velocity and z.

use super::body::{Material, Rest};
use super::kinematics::Flow;
use super::rows::{Block, FloorRef, Row, WIDTH};
use crate::multiply_add::MultiplyAdd;
use crate::transcendental::atan_small;

/// External force on the ceiling plane's centre and the compartment's excess volume.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(crate) struct External {
    /// `F_ex`, floor's frame \[N\].
    pub(crate) force: [Row; 3],
    /// `V − V_0` \[m³\].
    pub(crate) excess_volume: Row,
}

impl External {
    pub(crate) const ZERO: Self = Self { force: [[0.0; WIDTH]; 3], excess_volume: [0.0; WIDTH] };
}

/// Keeps a quotient of two vanishing numbers at zero; far below anything it is added to.
const TINY: f64 = 1e-290;

/// Sine times cosine of the incidence below which the lift's direction is undefined.
const LIFT_DEGENERACY: f64 = 1e-9;

#[inline(always)]
fn polynomial(coefficients: &[Row; 5], k: usize, x: f64) -> f64 {
    let square = x * x;
    let high = coefficients[0][k].madd(square, coefficients[1][k].madd(x, coefficients[2][k]));
    let low = coefficients[3][k].madd(x, coefficients[4][k]);
    high.madd(square, low)
}

/// How a compartment stands in the water: what the parts of the pass hand on.
///
/// Root upon root upon division is a chain longer than the processor looks ahead. So there are three parts,
/// each through several chunks before the next: [`speeds`], [`half_angles`], [`external`].
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(crate) struct Stream {
    /// Speed across the strut \[m/s\].
    across: Row,
    /// Speed \[m/s\].
    speed: Row,
    /// Tangent of half the angle between the velocity and the strut, or the plane square to it if that is
    /// nearer.
    half_tangent: Row,
    /// Sum of the mean radii of floor and ceiling \[m\].
    radii: Row,
    /// Volume \[m³\].
    volume: Row,
}

impl Stream {
    pub(crate) const ZERO: Self = Self {
        across: [0.0; WIDTH],
        speed: [0.0; WIDTH],
        half_tangent: [0.0; WIDTH],
        radii: [0.0; WIDTH],
        volume: [0.0; WIDTH],
    };
}

/// Volume and speeds.
#[inline(always)]
pub(crate) fn speeds(
    rest: &Rest,
    coordinates: &Block,
    floor: FloorRef<'_>,
    flow: &Flow,
    stream: &mut Stream,
    out: &mut External,
) {
    let q = &coordinates.0;
    for k in 0..WIDTH {
        let h = q[0][k];
        let base = 0.25
            * ((floor.radius[0][k] + floor.radius[1][k])
                + (floor.radius[2][k] + floor.radius[3][k]));
        let top = 0.25 * ((q[3][k] + q[4][k]) + (q[5][k] + q[6][k]));
        let squares = base.madd(base, top.madd(base, top * top));
        let volume = std::f64::consts::FRAC_PI_3 * h * squares;
        out.excess_volume[k] = volume - rest.volume[k];
        stream.volume[k] = volume;
        stream.radii[k] = base + top;

        let (x, y, z) = (flow.velocity[0][k], flow.velocity[1][k], flow.velocity[2][k]);
        let across_squared = x.madd(x, y * y);
        stream.across[k] = across_squared.sqrt();
        stream.speed[k] = z.madd(z, across_squared).sqrt();
    }
}

/// The angle of incidence, folded to [0, 45] degrees, as the tangent of its half.
#[inline(always)]
pub(crate) fn half_angles(flow: &Flow, stream: &mut Stream) {
    for k in 0..WIDTH {
        let (across, along) = (stream.across[k], flow.velocity[2][k].abs());
        let steep = across > along;
        let small = if steep { along } else { across };
        let large = if steep { across } else { along };
        stream.half_tangent[k] = small / (stream.speed[k] + large + TINY);
    }
}

/// The external force.
#[inline(always)]
pub(crate) fn external(
    material: &Material,
    coordinates: &Block,
    flow: &Flow,
    stream: &Stream,
    out: &mut External,
) {
    let q = &coordinates.0;
    for k in 0..WIDTH {
        let h = q[0][k];
        let (x, y, z) = (flow.velocity[0][k], flow.velocity[1][k], flow.velocity[2][k]);
        let (across, speed) = (stream.across[k], stream.speed[k]);
        let along = z.abs();

        // Angle of incidence, folded to [0, 90] degrees.
        let steep = across > along;
        let half = atan_small(stream.half_tangent[k]);
        let near = half * (360.0 / std::f64::consts::PI);
        let incidence = if steep { 90.0 - near } else { near };

        let pressure = material.pressure_area[k] * stream.radii[k] * h * speed;
        let drag = pressure * polynomial(&material.drag_coefficients, k, incidence);
        let lift = pressure
            * material.lift_scale[k]
            * polynomial(&material.lift_coefficients, k, incidence);

        // Lift: the part of −v across the strut, made orthogonal to v, has the unit vector
        // (−|v_z| v_⊥/|v_⊥| + |v_⊥| sign(v_z) z) / |v|.
        // It has no direction where the flow is along the strut or square to it; there, within
        // rounding, lift is zero, for its sign would be noise.
        let has_direction = along * across > LIFT_DEGENERACY * (speed * speed);
        let lift = if has_direction { lift } else { 0.0 };
        let sideways = -(drag + lift * along / (across + TINY));
        let lengthwise = (-drag).madd(z, lift * across.copysign(z));
        let weight = material.net_density[k] * stream.volume[k];
        out.force[0][k] = weight.madd(flow.gravity[0][k], sideways * x);
        out.force[1][k] = weight.madd(flow.gravity[1][k], sideways * y);
        out.force[2][k] = weight.madd(flow.gravity[2][k], lengthwise);
    }
}
