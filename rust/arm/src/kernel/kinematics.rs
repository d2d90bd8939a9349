//! Sines and cosines of the joints, velocities, and the accelerations that the planes would have if
//! every q̈ were zero.
//!
//! Carrying those accelerations outward (with everything a moving base brings: its angular
//! acceleration, centrifugal and Coriolis terms) leaves the articulated-body recursion without bias
//! accelerations. All are accelerations of points, in the classical sense.

use std::ops::Range;

use super::rows::{Block, Row, WIDTH};
use crate::base::BaseRows;
use crate::multiply_add::MultiplyAdd;
use crate::transcendental::sin_cos;

/// Sines and cosines of α and β.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(crate) struct Angles {
    pub(crate) sin_alpha: Row,
    pub(crate) cos_alpha: Row,
    pub(crate) sin_beta: Row,
    pub(crate) cos_beta: Row,
}

impl Angles {
    pub(crate) const ZERO: Self = Self {
        sin_alpha: [0.0; WIDTH],
        cos_alpha: [1.0; WIDTH],
        sin_beta: [0.0; WIDTH],
        cos_beta: [1.0; WIDTH],
    };
}

/// Sines and cosines of a chunk's joints.
#[inline(always)]
pub(crate) fn angles(coordinates: &Block, out: &mut Angles) {
    for k in 0..WIDTH {
        (out.sin_alpha[k], out.cos_alpha[k]) = sin_cos(coordinates.0[1][k]);
        (out.sin_beta[k], out.cos_beta[k]) = sin_cos(coordinates.0[2][k]);
    }
}

/// The base's motion in its own frame, one value a lane.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(crate) struct BaseFrame<const L: usize> {
    /// Angular velocity.
    pub(crate) omega: [[f64; L]; 3],
    /// Angular acceleration.
    pub(crate) psi: [[f64; L]; 3],
    /// Gravity.
    pub(crate) gravity: [[f64; L]; 3],
}

impl<const L: usize> BaseFrame<L> {
    /// The bases' motion as their own frames see it. Under [`crate::BaseCoupling::Gravity`] these frames are
    /// the arms' world: they stand still, and only gravity turns in them; `carries` says which arms a
    /// turning base carries along. `gravity` is the world's.
    #[inline(always)]
    pub(crate) fn new(motion: &BaseRows<L>, gravity: &[[f64; L]; 3], carries: &[bool; L]) -> Self {
        let mut frame = Self { omega: [[0.0; L]; 3], psi: [[0.0; L]; 3], gravity: [[0.0; L]; 3] };
        for lane in 0..L {
            let (sine_theta, cosine_theta) = sin_cos(motion.angle[0][lane]);
            let (s, c) = sin_cos(motion.angle[1][lane]);
            let felt = |value: f64| if carries[lane] { value } else { 0.0 };
            let (theta_rate, phi_rate) = (felt(motion.rate[0][lane]), felt(motion.rate[1][lane]));
            let theta_acceleration = felt(motion.acceleration[0][lane]);
            let phi_acceleration = felt(motion.acceleration[1][lane]);
            // R_0 = R_x(θ) R_y(φ): ω = θ̇ R_yᵀ x + φ̇ y.
            frame.omega[0][lane] = c * theta_rate;
            frame.omega[1][lane] = phi_rate;
            frame.omega[2][lane] = s * theta_rate;
            frame.psi[0][lane] = c.madd(theta_acceleration, -(s * theta_rate * phi_rate));
            frame.psi[1][lane] = phi_acceleration;
            frame.psi[2][lane] = s.madd(theta_acceleration, c * theta_rate * phi_rate);
            let (x, y, z) = (gravity[0][lane], gravity[1][lane], gravity[2][lane]);
            let (y, z) =
                (cosine_theta.madd(y, sine_theta * z), cosine_theta.madd(z, -(sine_theta * y)));
            frame.gravity[0][lane] = c.madd(x, -(s * z));
            frame.gravity[1][lane] = y;
            frame.gravity[2][lane] = c.madd(z, s * x);
        }
        frame
    }
}

/// Motion of a compartment's ceiling plane with q̈ = 0, in the plane's frame.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(crate) struct Motion {
    /// Angular velocity.
    pub(crate) omega: [Row; 3],
    /// Angular acceleration.
    pub(crate) psi: [Row; 3],
    /// Acceleration of the centre.
    pub(crate) acceleration: [Row; 3],
}

impl Motion {
    pub(crate) const ZERO: Self =
        Self { omega: [[0.0; WIDTH]; 3], psi: [[0.0; WIDTH]; 3], acceleration: [[0.0; WIDTH]; 3] };
}

/// What the water needs, in the frame of the compartment's floor (whose z is the strut).
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(crate) struct Flow {
    /// Velocity of the ceiling's centre.
    pub(crate) velocity: [Row; 3],
    /// Gravity.
    pub(crate) gravity: [Row; 3],
}

impl Flow {
    pub(crate) const ZERO: Self = Self { velocity: [[0.0; WIDTH]; 3], gravity: [[0.0; WIDTH]; 3] };
}

/// `R_x(α)ᵀ` on a vector.
#[inline(always)]
fn turn_x(v: [f64; 3], sine: f64, cosine: f64) -> [f64; 3] {
    [v[0], cosine.madd(v[1], sine * v[2]), cosine.madd(v[2], -(sine * v[1]))]
}

/// `R_y(β)ᵀ` on a vector.
#[inline(always)]
fn turn_y(v: [f64; 3], sine: f64, cosine: f64) -> [f64; 3] {
    [cosine.madd(v[0], -(sine * v[2])), v[1], cosine.madd(v[2], sine * v[0])]
}

/// Motion of the plane that the sweep has reached, in that plane's frame, one value a lane.
#[repr(C, align(64))]
pub(crate) struct Travel<const L: usize> {
    omega: [[f64; L]; 3],
    psi: [[f64; L]; 3],
    gravity: [[f64; L]; 3],
    velocity: [[f64; L]; 3],
    acceleration: [[f64; L]; 3],
}

impl<const L: usize> Travel<L> {
    #[inline(always)]
    pub(crate) fn from_base(base: &BaseFrame<L>) -> Self {
        Self {
            omega: base.omega,
            psi: base.psi,
            gravity: base.gravity,
            velocity: [[0.0; L]; 3],
            acceleration: [[0.0; L]; 3],
        }
    }
}

/// Through the compartments of a chunk whose slots are `slots`.
#[inline(always)]
pub(crate) fn outward<const L: usize>(
    slots: Range<usize>,
    travel: &mut Travel<L>,
    coordinates: &Block,
    rates: &Block,
    trig: &Angles,
    out: &mut Motion,
    flow: &mut Flow,
) {
    let (q, u) = (&coordinates.0, &rates.0);
    let Travel { omega, psi, gravity, velocity, acceleration } = travel;
    for slot in slots.step_by(L) {
        for lane in 0..L {
            let k = slot + lane;
            let (h, h_rate, a_rate, b_rate) = (q[0][k], u[0][k], u[1][k], u[2][k]);
            let w = [omega[0][lane], omega[1][lane], omega[2][lane]];
            let p = [psi[0][lane], psi[1][lane], psi[2][lane]];
            let v = [velocity[0][lane], velocity[1][lane], velocity[2][lane]];
            let a = [acceleration[0][lane], acceleration[1][lane], acceleration[2][lane]];
            let g = [gravity[0][lane], gravity[1][lane], gravity[2][lane]];

            // Along the strut, h z: v + ω × h z + ḣ z, a + ψ × h z + ω × (ω × h z) + 2 ḣ ω × z.
            let v = [h.madd(w[1], v[0]), (-h).madd(w[0], v[1]), v[2] + h_rate];
            let twice = 2.0 * h_rate;
            let a = [
                h.madd(w[0].madd(w[2], p[1]), twice.madd(w[1], a[0])),
                h.madd(w[1].madd(w[2], -p[0]), (-twice).madd(w[0], a[1])),
                (-h).madd(w[0].madd(w[0], w[1] * w[1]), a[2]),
            ];
            for axis in 0..3 {
                flow.velocity[axis][k] = v[axis];
                flow.gravity[axis][k] = g[axis];
            }

            // About x, then about y: ω + rate e, ψ + ω × rate e.
            let (sine, cosine) = (trig.sin_alpha[k], trig.cos_alpha[k]);
            let (w, p) = (turn_x(w, sine, cosine), turn_x(p, sine, cosine));
            let (v, a, g) =
                (turn_x(v, sine, cosine), turn_x(a, sine, cosine), turn_x(g, sine, cosine));
            let p = [p[0], w[2].madd(a_rate, p[1]), (-w[1]).madd(a_rate, p[2])];
            let w = [w[0] + a_rate, w[1], w[2]];

            let (sine, cosine) = (trig.sin_beta[k], trig.cos_beta[k]);
            let (w, p) = (turn_y(w, sine, cosine), turn_y(p, sine, cosine));
            let (v, a, g) =
                (turn_y(v, sine, cosine), turn_y(a, sine, cosine), turn_y(g, sine, cosine));
            let p = [(-w[2]).madd(b_rate, p[0]), p[1], w[0].madd(b_rate, p[2])];
            let w = [w[0], w[1] + b_rate, w[2]];

            for axis in 0..3 {
                out.omega[axis][k] = w[axis];
                out.psi[axis][k] = p[axis];
                out.acceleration[axis][k] = a[axis];
                omega[axis][lane] = w[axis];
                psi[axis][lane] = p[axis];
                velocity[axis][lane] = v[axis];
                acceleration[axis][lane] = a[axis];
                gravity[axis][lane] = g[axis];
            }
        }
    }
}
