//! Longitudinal and transverse springs with their volume forces (Eqs. 1, 3, 4, 7, 8).
//!
//! A longitudinal spring depends only on coordinates of its own compartment and the radii of the
//! floor. Its vector is taken in the floor's frame, `d = h z + σ (r e − r_0 u)`, where `e` is the
//! image of the axis `u` under `R_x(α) R_y(β)` and σ = ±1 tells springs 1, 2 from 3, 4.

use super::trigonometry::Angles;
use super::water::External;
use super::{Block, Floor, Material, Muscles, Rest, Row, WIDTH};

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

/// The bottom forces of the compartments one further from the base than those of chunk `c`.
#[inline(always)]
pub(crate) fn above<const L: usize>(bottoms: &[Bottom], c: usize) -> Bottom {
    let (this, next) = (&bottoms[c].0, &bottoms[c + 1].0);
    let mut out = Bottom::ZERO;
    for row in 0..10 {
        for k in 0..WIDTH {
            let from = k + L;
            out.0[row][k] = if from < WIDTH { this[row][from] } else { next[row][from - WIDTH] };
        }
    }
    out
}

/// Images of the x-axis and y-axis under `R_x(α) R_y(β)`; the y-axis's has no x component.
#[inline(always)]
fn axes(sa: f64, ca: f64, sb: f64, cb: f64) -> ([f64; 3], [f64; 2]) {
    ([cb, sa * sb, -(ca * sb)], [ca, sa])
}

/// Lengths of the four springs of every slot.
#[inline(always)]
pub(crate) fn lengths(coordinates: &Block, angles: &Angles, floor: &Floor, out: &mut [Row; 4]) {
    let q = &coordinates.0;
    for k in 0..WIDTH {
        let h = q[0][k];
        let (ex, ey) =
            axes(angles.sin_alpha[k], angles.cos_alpha[k], angles.sin_beta[k], angles.cos_beta[k]);
        let one = x_spring(1.0, h, q[3][k], floor.radius[0][k], ex);
        let two = y_spring(1.0, h, q[4][k], floor.radius[1][k], ey);
        let three = x_spring(-1.0, h, q[5][k], floor.radius[2][k], ex);
        let four = y_spring(-1.0, h, q[6][k], floor.radius[3][k], ey);
        out[0][k] = norm3(one);
        out[1][k] = norm2(two);
        out[2][k] = norm3(three);
        out[3][k] = norm2(four);
    }
}

#[inline(always)]
fn norm3(d: [f64; 3]) -> f64 {
    d[0].mul_add(d[0], d[1].mul_add(d[1], d[2] * d[2])).sqrt()
}

#[inline(always)]
fn norm2(d: [f64; 2]) -> f64 {
    d[0].mul_add(d[0], d[1] * d[1]).sqrt()
}

/// Vector of spring 1 (σ = 1) or 3 (σ = −1), floor's frame.
#[inline(always)]
fn x_spring(sigma: f64, h: f64, radius: f64, floor: f64, axis: [f64; 3]) -> [f64; 3] {
    let r = sigma * radius;
    [r.mul_add(axis[0], -(sigma * floor)), r * axis[1], r.mul_add(axis[2], h)]
}

/// Vector of spring 2 (σ = 1) or 4 (σ = −1), floor's frame, components y and z.
#[inline(always)]
fn y_spring(sigma: f64, h: f64, radius: f64, floor: f64, axis: [f64; 2]) -> [f64; 2] {
    let r = sigma * radius;
    [r.mul_add(axis[0], -(sigma * floor)), r.mul_add(axis[1], h)]
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
    floor: &Floor,
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
        // Rates of the images: the y-axis turns with α alone, the x-axis with α and β.
        let ex_rate = [
            -(sb * b_rate),
            (sa * cb).mul_add(b_rate, -(ex[2] * a_rate)),
            ex[1].mul_add(a_rate, -(ca * cb * b_rate)),
        ];
        let ey_rate = [-(sa * a_rate), ca * a_rate];

        let one = x_spring(1.0, h, q[3][k], floor.radius[0][k], ex);
        let two = y_spring(1.0, h, q[4][k], floor.radius[1][k], ey);
        let three = x_spring(-1.0, h, q[5][k], floor.radius[2][k], ex);
        let four = y_spring(-1.0, h, q[6][k], floor.radius[3][k], ey);

        let one_rate = x_spring_rate(1.0, h_rate, q[3][k], u[3][k], floor.rate[0][k], ex, ex_rate);
        let two_rate = y_spring_rate(1.0, h_rate, q[4][k], u[4][k], floor.rate[1][k], ey, ey_rate);
        let three_rate =
            x_spring_rate(-1.0, h_rate, q[5][k], u[5][k], floor.rate[2][k], ex, ex_rate);
        let four_rate =
            y_spring_rate(-1.0, h_rate, q[6][k], u[6][k], floor.rate[3][k], ey, ey_rate);

        let length = [norm3(one), norm2(two), norm3(three), norm2(four)];
        let inverse = [1.0 / length[0], 1.0 / length[1], 1.0 / length[2], 1.0 / length[3]];
        let stretch_rate = [
            dot3(one, one_rate) * inverse[0],
            dot2(two, two_rate) * inverse[1],
            dot3(three, three_rate) * inverse[2],
            dot2(four, four_rate) * inverse[3],
        ];

        let excess = external.excess_volume[k];
        let (total, applied) = (material.total[k], material.applied[k]);
        let mut tension_over_length = [0.0; 4];
        let mut ring = [0.0; 4];
        let mut sum = external.force[2][k];
        for i in 0..4 {
            let along = material.longitudinal_stiffness[k].mul_add(
                length[i] - material.rest_length[k],
                material.longitudinal_damping[k] * stretch_rate[i],
            );
            let across = material.transverse_stiffness[k].mul_add(
                q[3 + i][k] - rest.radius[k],
                material.transverse_damping[k] * u[3 + i][k],
            );
            let (xi_c, delta_c) = (muscles.longitudinal[i][k], muscles.transverse[i][k]);
            // Eq. 7.
            let xi_v = -(material.longitudinal_volume_gain[k]
                * (-total).mul_add(across, delta_c).abs()
                * excess);
            // The sum in Eq. 8.
            sum += xi_c + applied.mul_add(xi_v, -(total * along));
            tension_over_length[i] = (along - xi_c - xi_v) * inverse[i];
            ring[i] = delta_c - across;
        }
        // Eq. 8.
        let delta_v = -(material.transverse_volume_gain[k] * sum.abs() * excess);
        for i in 0..4 {
            top.transverse[i][k] = ring[i] + delta_v;
        }

        let pull = [one[0], one[1], one[2]].map(|d| d * tension_over_length[0]);
        for axis in 0..3 {
            bottom.0[axis][k] = pull[axis];
        }
        store(top, 0, k, into_ceiling(pull, sa, ca, sb, cb));
        let pull = [three[0], three[1], three[2]].map(|d| d * tension_over_length[2]);
        for axis in 0..3 {
            bottom.0[3 + axis][k] = pull[axis];
        }
        store(top, 2, k, into_ceiling(pull, sa, ca, sb, cb));
        let pull = [two[0] * tension_over_length[1], two[1] * tension_over_length[1]];
        bottom.0[6][k] = pull[0];
        bottom.0[7][k] = pull[1];
        store(top, 1, k, into_ceiling([0.0, pull[0], pull[1]], sa, ca, sb, cb));
        let pull = [four[0] * tension_over_length[3], four[1] * tension_over_length[3]];
        bottom.0[8][k] = pull[0];
        bottom.0[9][k] = pull[1];
        store(top, 3, k, into_ceiling([0.0, pull[0], pull[1]], sa, ca, sb, cb));
    }
}

#[inline(always)]
fn store(top: &mut Top, spring: usize, k: usize, force: [f64; 3]) {
    for axis in 0..3 {
        top.force[spring][axis][k] = force[axis];
    }
}

/// The reaction at the ceiling, `−R_y(β)ᵀ R_x(α)ᵀ f`.
#[inline(always)]
fn into_ceiling(f: [f64; 3], sa: f64, ca: f64, sb: f64, cb: f64) -> [f64; 3] {
    let y = ca.mul_add(f[1], sa * f[2]);
    let z = ca.mul_add(f[2], -(sa * f[1]));
    [sb.mul_add(z, -(cb * f[0])), -y, -(cb.mul_add(z, sb * f[0]))]
}

#[inline(always)]
fn dot3(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0].mul_add(b[0], a[1].mul_add(b[1], a[2] * b[2]))
}

#[inline(always)]
fn dot2(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0].mul_add(b[0], a[1] * b[1])
}

#[inline(always)]
fn x_spring_rate(
    sigma: f64,
    h_rate: f64,
    radius: f64,
    radius_rate: f64,
    floor_rate: f64,
    axis: [f64; 3],
    axis_rate: [f64; 3],
) -> [f64; 3] {
    let (r, r_rate) = (sigma * radius, sigma * radius_rate);
    [
        r_rate.mul_add(axis[0], r.mul_add(axis_rate[0], -(sigma * floor_rate))),
        r_rate.mul_add(axis[1], r * axis_rate[1]),
        r_rate.mul_add(axis[2], r.mul_add(axis_rate[2], h_rate)),
    ]
}

#[inline(always)]
fn y_spring_rate(
    sigma: f64,
    h_rate: f64,
    radius: f64,
    radius_rate: f64,
    floor_rate: f64,
    axis: [f64; 2],
    axis_rate: [f64; 2],
) -> [f64; 2] {
    let (r, r_rate) = (sigma * radius, sigma * radius_rate);
    [
        r_rate.mul_add(axis[0], r.mul_add(axis_rate[0], -(sigma * floor_rate))),
        r_rate.mul_add(axis[1], r.mul_add(axis_rate[1], h_rate)),
    ]
}
