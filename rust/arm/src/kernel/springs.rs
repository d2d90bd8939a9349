//! Longitudinal and transverse springs with their volume forces (Eqs. 1, 3, 4, 7, 8).
//!
//! A longitudinal spring depends only on coordinates of its own compartment and the radii of the
//! floor. Its vector is taken in the floor's frame, `d = h z + σ (r e − r_0 u)`, where `e` is the
//! image of the axis `u` under `R_x(α) R_y(β)` and σ = ±1 tells springs 1, 2 from 3, 4.

use crate::multiply_add::MultiplyAdd;

use super::body::{Material, Rest};
use super::kinematics::Angles;
use super::rows::{Block, FloorRef, Muscles, Row, WIDTH};
use super::water::External;

/// Forces on the ceiling's joints, ceiling's frame: of the four springs, and the transverse τ.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(crate) struct Top {
    pub(crate) force: [[Row; 3]; 4],
    pub(crate) transverse: [Row; 4],
}

impl Top {
    pub(crate) const ZERO: Self =
        Self { force: [[[0.0; WIDTH]; 3]; 4], transverse: [[0.0; WIDTH]; 4] };
}

/// Forces on the floor's joints, floor's frame: springs 1 and 3 `(x, y, z)` each, springs 2 and 4
/// `(y, z)` each (their x is zero).
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(crate) struct Bottom(pub(crate) [Row; 10]);

impl Bottom {
    pub(crate) const ZERO: Self = Self([[0.0; WIDTH]; 10]);
}

/// Index in [`Bottom`] of component `y` of each spring; x (springs 1 and 3) is before it, z after.
pub(crate) const BOTTOM_Y: [usize; 4] = [1, 6, 4, 8];

/// The bottom forces of the compartments one further from the base than those of a chunk with
/// bottoms `this`; `next` are the next chunk's. In `gathered` if they are not the next chunk's anyway.
#[inline(always)]
pub(crate) fn above<'a, const L: usize>(
    this: &Bottom,
    next: &'a Bottom,
    gathered: &'a mut Bottom,
) -> &'a Bottom {
    if L == WIDTH {
        return next;
    }
    for row in 0..10 {
        for k in 0..WIDTH {
            let from = k + L;
            gathered.0[row][k] =
                if from < WIDTH { this.0[row][from] } else { next.0[row][from - WIDTH] };
        }
    }
    gathered
}

/// Images of the x-axis and y-axis under `R_x(α) R_y(β)`; the y-axis's has no x component.
#[inline(always)]
fn axes(sa: f64, ca: f64, sb: f64, cb: f64) -> ([f64; 3], [f64; 2]) {
    ([cb, sa * sb, -(ca * sb)], [ca, sa])
}

/// Squared lengths of the four springs of every slot.
#[inline(always)]
pub(crate) fn squared_lengths(
    coordinates: &Block,
    angles: &Angles,
    floor: FloorRef<'_>,
    out: &mut [Row; 4],
) {
    let q = &coordinates.0;
    for k in 0..WIDTH {
        let h = q[0][k];
        let (ex, ey) =
            axes(angles.sin_alpha[k], angles.cos_alpha[k], angles.sin_beta[k], angles.cos_beta[k]);
        let one = x_spring(1.0, h, q[3][k], floor.radius[0][k], ex);
        let two = y_spring(1.0, h, q[4][k], floor.radius[1][k], ey);
        let three = x_spring(-1.0, h, q[5][k], floor.radius[2][k], ex);
        let four = y_spring(-1.0, h, q[6][k], floor.radius[3][k], ey);
        out[0][k] = square3(one);
        out[1][k] = square2(two);
        out[2][k] = square3(three);
        out[3][k] = square2(four);
    }
}

#[inline(always)]
fn square3(d: [f64; 3]) -> f64 {
    d[0].madd(d[0], d[1].madd(d[1], d[2] * d[2]))
}

#[inline(always)]
fn square2(d: [f64; 2]) -> f64 {
    d[0].madd(d[0], d[1] * d[1])
}

/// Vector of spring 1 (σ = 1) or 3 (σ = −1), floor's frame.
#[inline(always)]
fn x_spring(sigma: f64, h: f64, radius: f64, floor: f64, axis: [f64; 3]) -> [f64; 3] {
    let r = sigma * radius;
    [r.madd(axis[0], -(sigma * floor)), r * axis[1], r.madd(axis[2], h)]
}

/// Vector of spring 2 (σ = 1) or 4 (σ = −1), floor's frame, components y and z.
#[inline(always)]
fn y_spring(sigma: f64, h: f64, radius: f64, floor: f64, axis: [f64; 2]) -> [f64; 2] {
    let r = sigma * radius;
    [r.madd(axis[0], -(sigma * floor)), r.madd(axis[1], h)]
}

#[inline(always)]
#[allow(clippy::too_many_arguments)]
pub(crate) fn forces(
    material: &Material,
    rest: &Rest,
    muscles: &Muscles,
    coordinates: &Block,
    rates: &Block,
    angles: &Angles,
    floor: FloorRef<'_>,
    external: &External,
    top: &mut Top,
    bottom: &mut Bottom,
) {
    let (q, u) = (&coordinates.0, &rates.0);
    for k in 0..WIDTH {
        let (h, h_rate, a_rate, b_rate) = (q[0][k], u[0][k], u[1][k], u[2][k]);
        let (sa, ca) = (angles.sin_alpha[k], angles.cos_alpha[k]);
        let (sb, cb) = (angles.sin_beta[k], angles.cos_beta[k]);
        let (ex, ey) = axes(sa, ca, sb, cb);
        let (r1, r2, r3, r4) = (q[3][k], q[4][k], q[5][k], q[6][k]);
        let (f1, f2, f3, f4) =
            (floor.radius[0][k], floor.radius[1][k], floor.radius[2][k], floor.radius[3][k]);

        let one = x_spring(1.0, h, r1, f1, ex);
        let two = y_spring(1.0, h, r2, f2, ey);
        let three = x_spring(-1.0, h, r3, f3, ex);
        let four = y_spring(-1.0, h, r4, f4, ey);
        let square = [square3(one), square2(two), square3(three), square2(four)];
        let length = [square[0].sqrt(), square[1].sqrt(), square[2].sqrt(), square[3].sqrt()];
        // The division need not wait for the root.
        let inverse = [
            length[0] * (1.0 / square[0]),
            length[1] * (1.0 / square[1]),
            length[2] * (1.0 / square[2]),
            length[3] * (1.0 / square[3]),
        ];

        // The same vectors in the ceiling's frame, where the strut is h (−ca sb, sa, ca cb).
        let (hx, hy, hz) = (h * ex[2], h * sa, h * ca * cb);
        let (ux, uz) = (sa * sb, sa * cb);
        let one_up = [(-f1).madd(cb, hx + r1), hy, (-f1).madd(sb, hz)];
        let three_up = [f3.madd(cb, hx - r3), hy, f3.madd(sb, hz)];
        let two_up = [(-f2).madd(ux, hx), (-f2).madd(ca, hy + r2), f2.madd(uz, hz)];
        let four_up = [f4.madd(ux, hx), f4.madd(ca, hy - r4), (-f4).madd(uz, hz)];

        // Half the rate of the squared length,
        // d·ḋ = ḣ d_z + σ ṙ (d in the ceiling's frame)_u − σ ṙ_0 d_u + r (σ h ė_z − r_0 ė_u).
        let ex_rate = -(sb * b_rate);
        let hx_rate = h * ux.madd(a_rate, -(ca * cb * b_rate));
        let (ey_rate, hy_rate) = (-(sa * a_rate), h * (ca * a_rate));
        let rate = |i: usize| (u[3 + i][k], floor.rate[i][k]);
        let stretch_rate = [
            inverse[0]
                * squared_rate(h_rate * one[2], rate(0), (one_up[0], one[0]), {
                    r1 * (-f1).madd(ex_rate, hx_rate)
                }),
            inverse[1]
                * squared_rate(h_rate * two[1], rate(1), (two_up[1], two[0]), {
                    r2 * (-f2).madd(ey_rate, hy_rate)
                }),
            inverse[2]
                * squared_rate(h_rate * three[2], rate(2), (-three_up[0], -three[0]), {
                    -(r3 * f3.madd(ex_rate, hx_rate))
                }),
            inverse[3]
                * squared_rate(h_rate * four[1], rate(3), (-four_up[1], -four[0]), {
                    -(r4 * f4.madd(ey_rate, hy_rate))
                }),
        ];

        let excess = external.excess_volume[k];
        let (total, applied) = (material.total[k], material.applied[k]);
        let mut tension_over_length = [0.0; 4];
        let mut ring = [0.0; 4];
        let mut sum = external.force[2][k];
        for i in 0..4 {
            let along = material.longitudinal_stiffness[k].madd(
                length[i] - material.rest_length[k],
                material.longitudinal_damping[k] * stretch_rate[i],
            );
            let across = material.transverse_stiffness[k]
                .madd(q[3 + i][k] - rest.radius[k], material.transverse_damping[k] * u[3 + i][k]);
            let (xi_c, delta_c) = (muscles.longitudinal[i][k], muscles.transverse[i][k]);
            // Eq. 7.
            let xi_v = -(material.longitudinal_volume_gain[k]
                * (-total).madd(across, delta_c).abs()
                * excess);
            // The sum in Eq. 8.
            sum += xi_c + applied.madd(xi_v, -(total * along));
            tension_over_length[i] = (along - xi_c - xi_v) * inverse[i];
            ring[i] = delta_c - across;
        }
        // Eq. 8.
        let delta_v = -(material.transverse_volume_gain[k] * sum.abs() * excess);
        for i in 0..4 {
            top.transverse[i][k] = ring[i] + delta_v;
        }

        let [t1, t2, t3, t4] = tension_over_length;
        for axis in 0..3 {
            bottom.0[axis][k] = one[axis] * t1;
            bottom.0[3 + axis][k] = three[axis] * t3;
            top.force[0][axis][k] = one_up[axis] * -t1;
            top.force[1][axis][k] = two_up[axis] * -t2;
            top.force[2][axis][k] = three_up[axis] * -t3;
            top.force[3][axis][k] = four_up[axis] * -t4;
        }
        for axis in 0..2 {
            bottom.0[6 + axis][k] = two[axis] * t2;
            bottom.0[8 + axis][k] = four[axis] * t4;
        }
    }
}

/// Sum of the four parts of `d·ḋ`: of the strut, the two radii, and the joint's turning.
#[inline(always)]
fn squared_rate(strut: f64, rate: (f64, f64), along: (f64, f64), turning: f64) -> f64 {
    rate.0.madd(along.0, (-rate.1).madd(along.1, strut)) + turning
}
