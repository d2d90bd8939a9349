//! A ceiling plane with its four joint masses: inertia, bias wrench, radial accelerations.
//!
//! The four radial coordinates are leaves of the tree and are eliminated in closed form: across its
//! radius a joint mass is carried by the plane, along it the mass moves freely. With m = M_l + M_r the
//! plane's articulated inertia at its centre has the rotational block
//! m·diag(r2² + r4², r1² + r3², Σ r²), the linear block m·diag(2, 2, 4) and the coupling m·[s]×,
//! s = (r1 − r3, r2 − r4, 0).

use crate::multiply_add::MultiplyAdd;

use super::body::Material;
use super::kinematics::Motion;
use super::rows::{Block, Row, WIDTH};
use super::springs::{BOTTOM_Y, Bottom, Top};

/// What the articulated-body recursion needs of a plane, in the plane's frame.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(crate) struct Plane {
    /// Rotational inertia about x and about y (about z it is their sum).
    pub(crate) inertia: [Row; 2],
    /// First moments m (r1 − r3) and m (r2 − r4).
    pub(crate) moment: [Row; 2],
    /// Bias torque: with q̈ = 0, what the joints would have to give.
    pub(crate) torque: [Row; 3],
    /// Bias force, without the external force (which the recursion adds in the floor's frame).
    pub(crate) force: [Row; 3],
}

impl Plane {
    pub(crate) const ZERO: Self = Self {
        inertia: [[0.0; WIDTH]; 2],
        moment: [[0.0; WIDTH]; 2],
        torque: [[0.0; WIDTH]; 3],
        force: [[0.0; WIDTH]; 3],
    };
}

/// The plane, and its radial accelerations before the share of the plane's own acceleration.
#[inline(always)]
#[allow(clippy::too_many_arguments)]
pub(crate) fn assemble(
    material: &Material,
    coordinates: &Block,
    rates: &Block,
    motion: &Motion,
    top: &Top,
    above: &Bottom,
    out: &mut Plane,
    radial: &mut [Row; 4],
) {
    let (q, u) = (&coordinates.0, &rates.0);
    for k in 0..WIDTH {
        let (m, inverse_mass) = (material.joint_mass[k], material.inverse_joint_mass[k]);
        let (plane_mass, plane_inertia) = (material.plane_mass[k], material.plane_inertia[k]);
        let (wx, wy, wz) = (motion.omega[0][k], motion.omega[1][k], motion.omega[2][k]);
        let (px, py, pz) = (motion.psi[0][k], motion.psi[1][k], motion.psi[2][k]);
        let (ax, ay, az) =
            (motion.acceleration[0][k], motion.acceleration[1][k], motion.acceleration[2][k]);
        let (r1, r2, r3, r4) = (q[3][k], q[4][k], q[5][k], q[6][k]);
        let (t1, t2, t3, t4) = (
            top.transverse[0][k],
            top.transverse[1][k],
            top.transverse[2][k],
            top.transverse[3][k],
        );

        // Spring forces on the joints: this compartment's tops and the next one's bottoms.
        let f1x = top.force[0][0][k] + above.0[0][k];
        let f1y = top.force[0][1][k] + above.0[BOTTOM_Y[0]][k];
        let f1z = top.force[0][2][k] + above.0[BOTTOM_Y[0] + 1][k];
        let f2x = top.force[1][0][k];
        let f2y = top.force[1][1][k] + above.0[BOTTOM_Y[1]][k];
        let f2z = top.force[1][2][k] + above.0[BOTTOM_Y[1] + 1][k];
        let f3x = top.force[2][0][k] + above.0[3][k];
        let f3y = top.force[2][1][k] + above.0[BOTTOM_Y[2]][k];
        let f3z = top.force[2][2][k] + above.0[BOTTOM_Y[2] + 1][k];
        let f4x = top.force[3][0][k];
        let f4y = top.force[3][1][k] + above.0[BOTTOM_Y[3]][k];
        let f4z = top.force[3][2][k] + above.0[BOTTOM_Y[3] + 1][k];

        // Accelerations of the joints across their radii with q̈ = 0, per unit of σ:
        // ψ × r u + ω × (ω × r u) + 2 ṙ ω × u.
        let swing_xy = wx.madd(wy, pz);
        let swing_xz = wx.madd(wz, -py);
        let swing_yx = wx.madd(wy, -pz);
        let swing_yz = wy.madd(wz, px);
        let (two_wx, two_wy, two_wz) = (2.0 * wx, 2.0 * wy, 2.0 * wz);
        let (v1, v2, v3, v4) = (u[3][k], u[4][k], u[5][k], u[6][k]);
        let q1y = m.madd(ay + r1.madd(swing_xy, v1 * two_wz), -f1y);
        let q1z = m.madd(az + r1.madd(swing_xz, -(v1 * two_wy)), -f1z);
        let q3y = m.madd(ay - r3.madd(swing_xy, v3 * two_wz), -f3y);
        let q3z = m.madd(az - r3.madd(swing_xz, -(v3 * two_wy)), -f3z);
        let q2x = m.madd(ax + r2.madd(swing_yx, -(v2 * two_wz)), -f2x);
        let q2z = m.madd(az + r2.madd(swing_yz, v2 * two_wx), -f2z);
        let q4x = m.madd(ax - r4.madd(swing_yx, -(v4 * two_wz)), -f4x);
        let q4z = m.madd(az - r4.madd(swing_yz, v4 * two_wx), -f4z);

        out.force[0][k] = plane_mass.madd(ax, (q2x + q4x) + (t1 - t3));
        out.force[1][k] = plane_mass.madd(ay, (q1y + q3y) + (t2 - t4));
        out.force[2][k] = plane_mass.madd(az, (q1z + q3z) + (q2z + q4z));
        let gyro_x = wy.madd(wz, px);
        let gyro_y = (-wx).madd(wz, py);
        out.torque[0][k] = plane_inertia.madd(gyro_x, r2.madd(q2z, -(r4 * q4z)));
        out.torque[1][k] = plane_inertia.madd(gyro_y, r3.madd(q3z, -(r1 * q1z)));
        out.torque[2][k] =
            (2.0 * plane_inertia).madd(pz, r1.madd(q1y, -(r3 * q3y)) + r4.madd(q4x, -(r2 * q2x)));

        out.inertia[0][k] = m.madd(r2.madd(r2, r4 * r4), plane_inertia);
        out.inertia[1][k] = m.madd(r1.madd(r1, r3 * r3), plane_inertia);
        out.moment[0][k] = m * (r1 - r3);
        out.moment[1][k] = m * (r2 - r4);

        // r̈ = (F·u + τ)/m − a·u + r (ω² − (ω·u)²), Eqs. 1 and 4 along the radius.
        let spin_x = wy.madd(wy, wz * wz);
        let spin_y = wx.madd(wx, wz * wz);
        radial[0][k] = r1.madd(spin_x, (t1 + f1x).madd(inverse_mass, -ax));
        radial[2][k] = r3.madd(spin_x, (t3 - f3x).madd(inverse_mass, ax));
        radial[1][k] = r2.madd(spin_y, (t2 + f2y).madd(inverse_mass, -ay));
        radial[3][k] = r4.madd(spin_y, (t4 - f4y).madd(inverse_mass, ay));
    }
}
