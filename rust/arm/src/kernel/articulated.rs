//! The articulated-body recursion (Featherstone 2008, chapter 7) over three elementary joints a
//! compartment: prismatic along z, revolute about x, revolute about y. No joint carries a force.
//!
//! Notation: at a point, torque and force are `n = J ψ + H a`, `f = Hᵀ ψ + M a` plus bias, with ψ the
//! angular and `a` the linear acceleration beyond those with q̈ = 0 ([`super::kinematics`]). Projecting
//! a joint out leaves zeros in its row and column; only what can differ from zero is kept: 15 numbers
//! from plane to plane (J 6, H 3×2, M 3) and five of bias.

use std::ops::Range;

use crate::multiply_add::MultiplyAdd;

use super::body::Material;
use super::kinematics::Angles;
use super::plane::Plane;
use super::rows::{Block, Row, WIDTH};
use super::water::External;

/// What the outward sweep needs of each joint, divided by the joint's inertia.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(crate) struct Joints {
    /// Prismatic: bias, torque along the tilted axis, force x, force y.
    pub(crate) slide: [Row; 4],
    /// About x: bias, torque z, force x, y, z.
    pub(crate) about_x: [Row; 5],
    /// About y: bias, torque x, torque z, force x, y, z.
    pub(crate) about_y: [Row; 6],
}

impl Joints {
    pub(crate) const ZERO: Self =
        Self { slide: [[0.0; WIDTH]; 4], about_x: [[0.0; WIDTH]; 5], about_y: [[0.0; WIDTH]; 6] };
}

/// The articulated inertia and bias that a plane receives from all beyond it, one value a lane.
#[repr(C, align(64))]
pub(crate) struct Carried<const L: usize> {
    j_xx: [f64; L],
    j_xy: [f64; L],
    j_xz: [f64; L],
    j_yy: [f64; L],
    j_yz: [f64; L],
    j_zz: [f64; L],
    h_xx: [f64; L],
    h_xy: [f64; L],
    h_yx: [f64; L],
    h_yy: [f64; L],
    h_zx: [f64; L],
    h_zy: [f64; L],
    m_xx: [f64; L],
    m_xy: [f64; L],
    m_yy: [f64; L],
    torque: [[f64; L]; 3],
    force: [[f64; L]; 2],
}

impl<const L: usize> Carried<L> {
    /// Nothing is beyond the tip.
    pub(crate) const TIP: Self = Self {
        j_xx: [0.0; L],
        j_xy: [0.0; L],
        j_xz: [0.0; L],
        j_yy: [0.0; L],
        j_yz: [0.0; L],
        j_zz: [0.0; L],
        h_xx: [0.0; L],
        h_xy: [0.0; L],
        h_yx: [0.0; L],
        h_yy: [0.0; L],
        h_zx: [0.0; L],
        h_zy: [0.0; L],
        m_xx: [0.0; L],
        m_xy: [0.0; L],
        m_yy: [0.0; L],
        torque: [[0.0; L]; 3],
        force: [[0.0; L]; 2],
    };
}

/// Tip to base: projects every joint of a chunk out of the inertia beyond it.
#[allow(clippy::too_many_arguments)]
#[inline(always)]
pub(crate) fn inward<const L: usize>(
    slots: Range<usize>,
    carried: &mut Carried<L>,
    material: &Material,
    coordinates: &Block,
    plane: &Plane,
    trig: &Angles,
    external: &External,
    out: &mut Joints,
) {
    let q = &coordinates.0;
    let pull = &external.force;
    for slot in slots.step_by(L).rev() {
        for lane in 0..L {
            let k = slot + lane;
            let (jx, jy) = (plane.inertia[0][k], plane.inertia[1][k]);
            let (sx, sy) = (plane.moment[0][k], plane.moment[1][k]);
            let mass = 2.0f64.madd(material.joint_mass[k], material.plane_mass[k]);
            let mass_z = 2.0f64.madd(material.joint_mass[k], mass);

            // The plane itself, on what its child hands down.
            let j_xx = carried.j_xx[lane] + jx;
            let (j_xy, j_xz) = (carried.j_xy[lane], carried.j_xz[lane]);
            let j_yy = carried.j_yy[lane] + jy;
            let j_yz = carried.j_yz[lane];
            let j_zz = carried.j_zz[lane] + (jx + jy);
            let (h_xx, h_xy) = (carried.h_xx[lane], carried.h_xy[lane]);
            let (h_yx, h_yy) = (carried.h_yx[lane], carried.h_yy[lane]);
            let (h_zx, h_zy) = (carried.h_zx[lane], carried.h_zy[lane]);
            let m_xx = carried.m_xx[lane] + mass;
            let (m_xy, m_yy) = (carried.m_xy[lane], carried.m_yy[lane] + mass);
            let n_x = carried.torque[0][lane] + plane.torque[0][k];
            let n_y = carried.torque[1][lane] + plane.torque[1][k];
            let n_z = carried.torque[2][lane] + plane.torque[2][k];
            let f_x = carried.force[0][lane] + plane.force[0][k];
            let f_y = carried.force[1][lane] + plane.force[1][k];
            let f_z = plane.force[2][k];

            // Into the frame between the joints, in which both are about an axis:
            // (x, z) → (c x + s z, c z − s x). Of a symmetric pair xx, zz with xz only the difference
            // turns: xx + s w, zz − s w, xz + s v with w = s (zz − xx) + 2 c xz and
            // v = c (zz − xx) − 2 s xz.
            let (s, c) = (trig.sin_beta[k], trig.cos_beta[k]);
            let difference = j_zz - j_xx;
            let w = s.madd(difference, (c + c) * j_xz);
            let v = c.madd(difference, -((s + s) * j_xz));
            let j_xx = s.madd(w, j_xx);
            let j_zz = (-s).madd(w, j_zz);
            let j_xz = s.madd(v, j_xz);
            let (j_xy, j_yz) = (c.madd(j_xy, s * j_yz), c.madd(j_yz, -(s * j_xy)));
            // What the child hands down has no column z; the plane's own part is the cross product
            // with its first moment, which turns to (c s_x, s_y, −s s_x).
            let (turned_x, turned_z) = (c * sx, s * sx);
            let (a, b) = (c.madd(h_xx, s * h_zx), c.madd(h_zx, -(s * h_xx)));
            let (h_xx, h_xz) = (c * a, (-s).madd(a, sy));
            let (h_zx, h_zz) = (c.madd(b, -sy), -(s * b));
            let (h_xy, h_zy) =
                (c.madd(h_xy, s.madd(h_zy, turned_z)), c.madd(h_zy, (-s).madd(h_xy, turned_x)));
            let (h_yx, h_yz) = (c.madd(h_yx, -turned_z), -(s.madd(h_yx, turned_x)));
            let d = s * (mass_z - m_xx);
            let (m_xx, m_xz, m_zz) = (s.madd(d, m_xx), c * d, (-s).madd(d, mass_z));
            let (m_xy, m_yz) = (c * m_xy, -(s * m_xy));
            let (n_x, n_z) = (c.madd(n_x, s * n_z), c.madd(n_z, -(s * n_x)));
            let (f_x, f_z) = (c.madd(f_x, s * f_z), c.madd(f_z, -(s * f_x)));

            // Joint about y.
            let inverse = 1.0 / j_yy;
            let (tx, tz) = (j_xy * inverse, j_yz * inverse);
            let (ux, uy, uz) = (h_yx * inverse, h_yy * inverse, h_yz * inverse);
            out.about_y[0][k] = n_y * inverse;
            out.about_y[1][k] = tx;
            out.about_y[2][k] = tz;
            out.about_y[3][k] = ux;
            out.about_y[4][k] = uy;
            out.about_y[5][k] = uz;
            let j_xx = (-tx).madd(j_xy, j_xx);
            let j_xz = (-tx).madd(j_yz, j_xz);
            let j_zz = (-tz).madd(j_yz, j_zz);
            let h_xx = (-tx).madd(h_yx, h_xx);
            let h_xy = (-tx).madd(h_yy, h_xy);
            let h_xz = (-tx).madd(h_yz, h_xz);
            let h_zx = (-tz).madd(h_yx, h_zx);
            let h_zy = (-tz).madd(h_yy, h_zy);
            let h_zz = (-tz).madd(h_yz, h_zz);
            let m_xx = (-ux).madd(h_yx, m_xx);
            let m_xy = (-ux).madd(h_yy, m_xy);
            let m_xz = (-ux).madd(h_yz, m_xz);
            let m_yy = (-uy).madd(h_yy, m_yy);
            let m_yz = (-uy).madd(h_yz, m_yz);
            let m_zz = (-uz).madd(h_yz, m_zz);
            let n_x = (-tx).madd(n_y, n_x);
            let n_z = (-tz).madd(n_y, n_z);
            let f_x = (-ux).madd(n_y, f_x);
            let f_y = (-uy).madd(n_y, f_y);
            let f_z = (-uz).madd(n_y, f_z);

            // Joint about x. After it only torques about z remain.
            let inverse = 1.0 / j_xx;
            let tz = j_xz * inverse;
            let (ux, uy, uz) = (h_xx * inverse, h_xy * inverse, h_xz * inverse);
            out.about_x[0][k] = n_x * inverse;
            out.about_x[1][k] = tz;
            out.about_x[2][k] = ux;
            out.about_x[3][k] = uy;
            out.about_x[4][k] = uz;
            let j_zz = (-tz).madd(j_xz, j_zz);
            let h_zx = (-tz).madd(h_xx, h_zx);
            let h_zy = (-tz).madd(h_xy, h_zy);
            let h_zz = (-tz).madd(h_xz, h_zz);
            let m_xx = (-ux).madd(h_xx, m_xx);
            let m_xy = (-ux).madd(h_xy, m_xy);
            let m_xz = (-ux).madd(h_xz, m_xz);
            let m_yy = (-uy).madd(h_xy, m_yy);
            let m_yz = (-uy).madd(h_xz, m_yz);
            let m_zz = (-uz).madd(h_xz, m_zz);
            let n_z = (-tz).madd(n_x, n_z);
            let f_x = (-ux).madd(n_x, f_x);
            let f_y = (-uy).madd(n_x, f_y);
            let f_z = (-uz).madd(n_x, f_z);

            // Into the floor's frame: (y, z) → (c y − s z, s y + c z). The torque lies along
            // e = (0, −s, c): J = j e eᵀ, H = e kᵀ.
            let (s, c) = (trig.sin_alpha[k], trig.cos_alpha[k]);
            let k_x = h_zx;
            let (k_y, k_z) = (c.madd(h_zy, -(s * h_zz)), c.madd(h_zz, s * h_zy));
            let difference = m_zz - m_yy;
            let w = s.madd(difference, -((c + c) * m_yz));
            let v = c.madd(difference, (s + s) * m_yz);
            let m_yy = s.madd(w, m_yy);
            let m_zz = (-s).madd(w, m_zz);
            let m_yz = (-s).madd(v, m_yz);
            let (m_xy, m_xz) = (c.madd(m_xy, -(s * m_xz)), c.madd(m_xz, s * m_xy));
            let (f_y, f_z) = (c.madd(f_y, -(s * f_z)), c.madd(f_z, s * f_y));
            let (f_x, f_y, f_z) = (f_x - pull[0][k], f_y - pull[1][k], f_z - pull[2][k]);

            // Prismatic joint along z.
            let inverse = 1.0 / m_zz;
            let t = k_z * inverse;
            let (ux, uy) = (m_xz * inverse, m_yz * inverse);
            out.slide[0][k] = f_z * inverse;
            out.slide[1][k] = t;
            out.slide[2][k] = ux;
            out.slide[3][k] = uy;
            let j = (-t).madd(k_z, j_zz);
            let k_x = (-ux).madd(k_z, k_x);
            let k_y = (-uy).madd(k_z, k_y);
            let m_xx = (-ux).madd(m_xz, m_xx);
            let m_xy = (-ux).madd(m_yz, m_xy);
            let m_yy = (-uy).madd(m_yz, m_yy);
            let n = (-t).madd(f_z, n_z);
            let f_x = (-ux).madd(f_z, f_x);
            let f_y = (-uy).madd(f_z, f_y);

            // Down the strut to the floor's centre: a → a + ψ × h z.
            let h = q[0][k];
            let (sj, cj) = (s * j, c * j);
            let leaned = s * k_x;
            let h_xx = -(h * m_xy);
            let h_xy = -(h * m_yy);
            let h_yx = h.madd(m_xx, -leaned);
            let h_yy = h.madd(m_xy, -(s * k_y));
            let (h_zx, h_zy) = (c * k_x, c * k_y);
            carried.j_xx[lane] = -(h * h_xy);
            carried.j_xy[lane] = -(h * h_yy);
            carried.j_xz[lane] = -(h * h_zy);
            carried.j_yy[lane] = h.madd(h_yx - leaned, s * sj);
            carried.j_yz[lane] = h.madd(h_zx, -(s * cj));
            carried.j_zz[lane] = c * cj;
            carried.h_xx[lane] = h_xx;
            carried.h_xy[lane] = h_xy;
            carried.h_yx[lane] = h_yx;
            carried.h_yy[lane] = h_yy;
            carried.h_zx[lane] = h_zx;
            carried.h_zy[lane] = h_zy;
            carried.m_xx[lane] = m_xx;
            carried.m_xy[lane] = m_xy;
            carried.m_yy[lane] = m_yy;
            carried.torque[0][lane] = -(h * f_y);
            carried.torque[1][lane] = h.madd(f_x, -(s * n));
            carried.torque[2][lane] = c * n;
            carried.force[0][lane] = f_x;
            carried.force[1][lane] = f_y;
        }
    }
}

/// Acceleration, beyond that with q̈ = 0, of the plane that the outward sweep has reached.
#[repr(C, align(64))]
pub(crate) struct Travel<const L: usize> {
    psi: [[f64; L]; 3],
    linear: [[f64; L]; 3],
}

impl<const L: usize> Travel<L> {
    pub(crate) const BASE: Self = Self { psi: [[0.0; L]; 3], linear: [[0.0; L]; 3] };
}

/// Base to tip: the accelerations of a chunk's coordinates.
#[allow(clippy::too_many_arguments)]
#[inline(always)]
pub(crate) fn outward<const L: usize>(
    slots: Range<usize>,
    travel: &mut Travel<L>,
    coordinates: &Block,
    trig: &Angles,
    radial: &[Row; 4],
    joint: &Joints,
    accelerations: &mut Block,
) {
    let q = &coordinates.0;
    let Travel { psi, linear } = travel;
    let out = &mut accelerations.0;
    for slot in slots.step_by(L) {
        for lane in 0..L {
            let k = slot + lane;
            let h = q[0][k];
            let (p_x, p_y, p_z) = (psi[0][lane], psi[1][lane], psi[2][lane]);
            let a_x = h.madd(p_y, linear[0][lane]);
            let a_y = (-h).madd(p_x, linear[1][lane]);
            let before = linear[2][lane];

            // About x the torque axis e is the frame's z. In every sum the summand that is known
            // last is added last.
            let (s, c) = (trig.sin_alpha[k], trig.cos_alpha[k]);
            let (p_y, p_z) = (c.madd(p_y, s * p_z), c.madd(p_z, -(s * p_y)));
            let slide = &joint.slide;
            let a_z = (-slide[1][k])
                .madd(p_z, (-slide[2][k]).madd(a_x, (-slide[3][k]).madd(a_y, -slide[0][k])));
            out[0][k] = a_z - before;

            let (a_y, a_z) = (s.madd(a_z, c * a_y), c.madd(a_z, -(s * a_y)));
            let x = &joint.about_x;
            let turned = (-x[4][k]).madd(
                a_z,
                (-x[3][k]).madd(a_y, (-x[2][k]).madd(a_x, (-x[1][k]).madd(p_z, -x[0][k]))),
            );
            out[1][k] = turned - p_x;
            let p_x = turned;

            let y = &joint.about_y;
            let turned = (-y[1][k]).madd(
                p_x,
                (-y[5][k]).madd(
                    a_z,
                    (-y[4][k]).madd(a_y, (-y[3][k]).madd(a_x, (-y[2][k]).madd(p_z, -y[0][k]))),
                ),
            );
            out[2][k] = turned - p_y;

            let (s, c) = (trig.sin_beta[k], trig.cos_beta[k]);
            let (p_x, p_z) = (c.madd(p_x, -(s * p_z)), s.madd(p_x, c * p_z));
            let (a_x, a_z) = ((-s).madd(a_z, c * a_x), c.madd(a_z, s * a_x));

            out[3][k] = radial[0][k] - a_x;
            out[4][k] = radial[1][k] - a_y;
            out[5][k] = radial[2][k] + a_x;
            out[6][k] = radial[3][k] + a_y;
            psi[0][lane] = p_x;
            psi[1][lane] = turned;
            psi[2][lane] = p_z;
            linear[0][lane] = a_x;
            linear[1][lane] = a_y;
            linear[2][lane] = a_z;
        }
    }
}
