//! What a state looks like: positions, volumes and energy, in the world frame.

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use crate::parameters::{ArmParameters, BaseCoupling, frustum_volume};
use crate::state::ArmState;
use crate::transcendental::sin_cos;

/// Mechanical energy of the arm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Energy {
    /// Of all joint masses and planes \[J\]: in the world under [`BaseCoupling::Inertial`], relative to
    /// the base under [`BaseCoupling::Gravity`].
    pub kinetic: f64,
    /// Elastic energy of all springs \[J\].
    pub elastic: f64,
}

fn about_x(angle: f64) -> Matrix3<f64> {
    let (s, c) = sin_cos(angle);
    Matrix3::new(1.0, 0.0, 0.0, 0.0, c, -s, 0.0, s, c)
}

fn about_y(angle: f64) -> Matrix3<f64> {
    let (s, c) = sin_cos(angle);
    Matrix3::new(c, 0.0, s, 0.0, 1.0, 0.0, -s, 0.0, c)
}

/// Position, frame, angular and linear velocity of a plane, along the axes of the world.
struct PlanePose {
    centre: Vector3<f64>,
    frame: Matrix3<f64>,
    omega: Vector3<f64>,
    velocity: Vector3<f64>,
}

fn base_pose(coupling: BaseCoupling, state: &ArmState) -> PlanePose {
    let [theta, phi, theta_rate, phi_rate] = state.base;
    let (theta_rate, phi_rate) = match coupling {
        BaseCoupling::Gravity => (0.0, 0.0),
        BaseCoupling::Inertial => (theta_rate, phi_rate),
    };
    let first = about_x(theta);
    PlanePose {
        centre: Vector3::zeros(),
        frame: first * about_y(phi),
        omega: first.column(0) * theta_rate + first.column(1) * phi_rate,
        velocity: Vector3::zeros(),
    }
}

fn next_pose(floor: &PlanePose, q: &[f64; 7], u: &[f64; 7]) -> PlanePose {
    let strut = floor.frame.column(2) * q[0];
    let tilted = floor.frame * about_x(q[1]);
    PlanePose {
        centre: floor.centre + strut,
        frame: tilted * about_y(q[2]),
        omega: floor.omega + floor.frame.column(0) * u[1] + tilted.column(1) * u[2],
        velocity: floor.velocity + floor.omega.cross(&strut) + floor.frame.column(2) * u[0],
    }
}

/// All planes, base first; velocities as the body's coupling sees them.
fn poses(coupling: BaseCoupling, state: &ArmState) -> Vec<PlanePose> {
    let mut poses = vec![base_pose(coupling, state)];
    for (q, u) in state.coordinates.iter().zip(&state.rates) {
        let pose = next_pose(&poses[poses.len() - 1], q, u);
        poses.push(pose);
    }
    poses
}

/// Directions u_1 to u_4 of the struts in a plane's own frame (Fig. 1).
fn strut_directions() -> [Vector3<f64>; 4] {
    [Vector3::x(), Vector3::y(), -Vector3::x(), -Vector3::y()]
}

impl ArmState {
    /// Centres of all planes, base first \[m\].
    #[must_use]
    pub fn positions(&self) -> Vec<[f64; 3]> {
        poses(BaseCoupling::Gravity, self).iter().map(|pose| pose.centre.into()).collect()
    }

    /// Ends P_ij of the longitudinal springs on all planes, base first, springs 1 to 4 of each \[m\];
    /// spring i of compartment j runs from `joints[j - 1][i - 1]` to `joints[j][i - 1]`.
    #[must_use]
    pub fn joints(&self, parameters: &ArmParameters) -> Vec<[[f64; 3]; 4]> {
        let base = [parameters.base_radius; 4];
        let radii =
            std::iter::once(base).chain(self.coordinates.iter().map(|q| [q[3], q[4], q[5], q[6]]));
        let directions = strut_directions();
        poses(parameters.base_coupling, self)
            .iter()
            .zip(radii)
            .map(|(pose, radii)| {
                [0, 1, 2, 3].map(|i| (pose.centre + pose.frame * directions[i] * radii[i]).into())
            })
            .collect()
    }

    /// Volume of every compartment \[m³\], from the mean radii of its floor and ceiling.
    #[must_use]
    pub fn volumes(&self, parameters: &ArmParameters) -> Vec<f64> {
        let mut floor = parameters.base_radius;
        self.coordinates
            .iter()
            .map(|q| {
                let ceiling = (q[3] + q[4] + q[5] + q[6]) / 4.0;
                let volume = frustum_volume(floor, ceiling, q[0]);
                floor = ceiling;
                volume
            })
            .collect()
    }
}

/// Kinetic and elastic energy; `lengths` are the longitudinal springs', in observation order.
#[must_use]
pub(crate) fn energy(parameters: &ArmParameters, state: &ArmState, lengths: &[f64]) -> Energy {
    let directions = strut_directions();
    let mut kinetic = 0.0;
    let mut elastic = 0.0;
    for (j, pose) in poses(parameters.base_coupling, state).iter().enumerate().skip(1) {
        let (q, u) = (&state.coordinates[j - 1], &state.rates[j - 1]);
        let mass = parameters.joint_mass(j - 1);
        let inertia = parameters.plane_inertia.at(j - 1);
        for (i, direction) in directions.iter().enumerate() {
            let out = pose.frame * direction;
            let velocity = pose.velocity + pose.omega.cross(&out) * q[3 + i] + out * u[3 + i];
            kinetic += 0.5 * mass * velocity.norm_squared();
            let widening = q[3 + i] - parameters.rest_radius(j);
            let stretch = lengths[4 * (j - 1) + i] - parameters.rest_length;
            elastic += 0.5 * parameters.transverse_stiffness.at(j - 1) * widening * widening
                + 0.5 * parameters.longitudinal_stiffness.at(j - 1) * stretch * stretch;
        }
        let spin = pose.frame.transpose() * pose.omega;
        kinetic += 0.5 * parameters.plane_mass.at(j - 1) * pose.velocity.norm_squared()
            + 0.5 * inertia * (spin.x * spin.x + spin.y * spin.y + 2.0 * spin.z * spin.z);
    }
    Energy { kinetic, elastic }
}
