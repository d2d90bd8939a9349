//! A plain, slow reference of the arm's dynamics, to verify the fast kernel against.
//!
//! It is an independent derivation: d'Alembert's principle in the generalised coordinates
//! `[h, α, β, r1..r4]` of every compartment, with every vector in the world frame, a dense mass
//! matrix and a Cholesky factorisation. For every mass `m` at `P`, with `J = ∂P/∂q` and the
//! acceleration `b` that `P` would have with `q̈ = 0`,
//!
//! ```text
//! Σ m JᵀJ q̈ = Σ Jᵀ (F − m b),
//! ```
//!
//! plus the planes' own inertia. It shares with the kernel the parameters and the state, no
//! formula. Nothing here is fast: the cost grows with the cube of the number of compartments.

// Every test binary includes this file and uses its own part of it.
#![allow(dead_code, unreachable_pub)]

use std::f64::consts::PI;

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use octoarm_arm::{ArmParameters, ArmState, BaseCoupling, ReferenceArea, VolumeForce};

/// The lift has no direction if what remains of the velocity's normal part, after making it
/// orthogonal to the velocity, is at most this fraction of the speed: the flow is then along the
/// axis or across it.
pub const LIFT_DEGENERACY: f64 = 1e-9;

/// Coordinates of a compartment: `[h, α, β, r1, r2, r3, r4]`.
const COORDINATES: usize = 7;

/// Motion of the base at one instant, `[θ, φ]`.
#[derive(Clone, Copy, Debug, Default)]
pub struct BaseSample {
    /// Angles \[rad\].
    pub angle: [f64; 2],
    /// Angular rates \[rad/s\].
    pub rate: [f64; 2],
    /// Angular accelerations \[rad/s²\].
    pub acceleration: [f64; 2],
}

/// The arm's state, integrated with a dense mass matrix.
#[derive(Clone, Debug)]
pub struct Reference {
    /// The body's parameters.
    pub parameters: ArmParameters,
    /// `[h, α, β, r1..r4]` of every compartment \[m, rad, rad, m…\].
    pub coordinates: Vec<[f64; 7]>,
    /// Time derivatives of the coordinates.
    pub rates: Vec<[f64; 7]>,
    /// Control force `ξ_c` of every longitudinal spring \[N\].
    pub longitudinal_muscles: Vec<[f64; 4]>,
    /// Control force `δ_c` of every transverse spring \[N\].
    pub transverse_muscles: Vec<[f64; 4]>,
}

/// A point's motion in the world frame; `bias` is its acceleration if all `q̈` were zero.
#[derive(Clone, Copy)]
struct Point {
    position: Vector3<f64>,
    velocity: Vector3<f64>,
    bias: Vector3<f64>,
}

/// A plane's motion in the world frame, and the axes of the joint that leads to it.
struct Plane {
    rotation: Matrix3<f64>,
    centre: Point,
    /// Angular velocity.
    spin: Vector3<f64>,
    /// Angular acceleration if all `q̈` were zero.
    spin_bias: Vector3<f64>,
    /// The strut's direction `n_{j−1}`.
    slide: Vector3<f64>,
    /// Axes of `α` and `β`; both pass through the plane's centre.
    hinges: [Vector3<f64>; 2],
    /// Directions `u_i` from the centre to the joints.
    outward: [Vector3<f64>; 4],
    /// The joints `P_ij`.
    joints: [Point; 4],
}

/// Forces on the masses of one plane \[N\], world frame.
#[derive(Clone, Copy)]
struct Loads {
    joints: [Vector3<f64>; 4],
    centre: Vector3<f64>,
}

/// A longitudinal spring.
struct Spring {
    length: f64,
    rate: f64,
    /// From the floor's joint to the ceiling's.
    direction: Vector3<f64>,
}

/// One column of a point's Jacobian and the number of its coordinate.
type Column = (usize, Vector3<f64>);

impl Plane {
    /// The plane with the rotation and motion given; joints at `radii` moving at `radial_rates`.
    fn new(
        rotation: Matrix3<f64>,
        [spin, spin_bias]: [Vector3<f64>; 2],
        centre: Point,
        slide: Vector3<f64>,
        hinges: [Vector3<f64>; 2],
        [radii, radial_rates]: [[f64; 4]; 2],
    ) -> Self {
        let outward = [
            rotation * Vector3::x(),
            rotation * Vector3::y(),
            -(rotation * Vector3::x()),
            -(rotation * Vector3::y()),
        ];
        let joints = std::array::from_fn(|i| {
            let (u, r, rate) = (outward[i], radii[i], radial_rates[i]);
            let arm = r * u;
            Point {
                position: centre.position + arm,
                velocity: centre.velocity + spin.cross(&arm) + rate * u,
                bias: centre.bias
                    + spin_bias.cross(&arm)
                    + spin.cross(&spin.cross(&arm))
                    + 2.0 * rate * spin.cross(&u),
            }
        });
        Self { rotation, centre, spin, spin_bias, slide, hinges, outward, joints }
    }
}

impl Reference {
    /// The arm in `state`, all muscles slack.
    pub fn new(parameters: &ArmParameters, state: &ArmState) -> Self {
        let compartments = parameters.compartments;
        Self {
            parameters: parameters.clone(),
            coordinates: state.coordinates.clone(),
            rates: state.rates.clone(),
            longitudinal_muscles: vec![[0.0; 4]; compartments],
            transverse_muscles: vec![[0.0; 4]; compartments],
        }
    }

    /// Second time derivatives of the coordinates, for a base that moves as `base`.
    pub fn accelerations(&self, base: &BaseSample) -> Vec<[f64; 7]> {
        let planes = self.planes(base);
        let loads = self.loads(&planes);
        let size = COORDINATES * self.coordinates.len();
        let mut mass_matrix = DMatrix::zeros(size, size);
        let mut force = DVector::zeros(size);

        for (j, plane) in planes.iter().enumerate().skip(1) {
            let load = &loads[j];
            let joint_mass = self.joint_mass(j);
            for i in 0..4 {
                let joint = &plane.joints[i];
                let mut columns = carried(&planes, j, &joint.position);
                columns.push((COORDINATES * (j - 1) + 3 + i, plane.outward[i]));
                let applied = load.joints[i] - joint_mass * joint.bias;
                project(&columns, &applied, &mut force);
                accumulate(&columns, &(joint_mass * Matrix3::identity()), &mut mass_matrix);
            }

            let columns = carried(&planes, j, &plane.centre.position);
            let plane_mass = self.parameters.plane_mass.at(j - 1);
            let applied = load.centre - plane_mass * plane.centre.bias;
            project(&columns, &applied, &mut force);
            accumulate(&columns, &(plane_mass * Matrix3::identity()), &mut mass_matrix);

            let inertia = self.plane_inertia(j, plane);
            let columns = turned(&planes, j);
            let momentum = inertia * plane.spin;
            let applied = -(inertia * plane.spin_bias + plane.spin.cross(&momentum));
            project(&columns, &applied, &mut force);
            accumulate(&columns, &inertia, &mut mass_matrix);
        }

        // Only the lower triangle is filled, and only it is read.
        let solution = mass_matrix.cholesky().expect("mass matrix not positive definite");
        let flat = solution.solve(&force);
        (0..self.coordinates.len())
            .map(|j| std::array::from_fn(|k| flat[COORDINATES * j + k]))
            .collect()
    }

    /// One step of the fourth-order Runge–Kutta method; `base` is the base's motion at the start,
    /// the middle and the end of the step.
    pub fn step(&mut self, base: &[BaseSample; 3]) {
        let dt = self.parameters.timestep;
        let start = self.clone();

        let velocity_1 = start.rates.clone();
        let acceleration_1 = start.accelerations(&base[0]);

        let stage = start.moved(0.5 * dt, &velocity_1, &acceleration_1);
        let velocity_2 = stage.rates.clone();
        let acceleration_2 = stage.accelerations(&base[1]);

        let stage = start.moved(0.5 * dt, &velocity_2, &acceleration_2);
        let velocity_3 = stage.rates.clone();
        let acceleration_3 = stage.accelerations(&base[1]);

        let stage = start.moved(dt, &velocity_3, &acceleration_3);
        let velocity_4 = stage.rates.clone();
        let acceleration_4 = stage.accelerations(&base[2]);

        for j in 0..self.coordinates.len() {
            for k in 0..COORDINATES {
                self.coordinates[j][k] += dt / 6.0
                    * (velocity_1[j][k]
                        + 2.0 * (velocity_2[j][k] + velocity_3[j][k])
                        + velocity_4[j][k]);
                self.rates[j][k] += dt / 6.0
                    * (acceleration_1[j][k]
                        + 2.0 * (acceleration_2[j][k] + acceleration_3[j][k])
                        + acceleration_4[j][k]);
            }
        }
    }

    /// Lengths of the longitudinal springs \[m\], spring `i` of compartment `j` at
    /// `4 (j − 1) + (i − 1)`: the distances of the joints in the world frame.
    pub fn lengths(&self, angle: [f64; 2]) -> Vec<f64> {
        let planes = self.planes(&BaseSample { angle, ..BaseSample::default() });
        planes
            .windows(2)
            .flat_map(|pair| {
                (0..4).map(|i| (pair[1].joints[i].position - pair[0].joints[i].position).norm())
            })
            .collect()
    }

    /// Kinetic energy \[J\].
    pub fn kinetic_energy(&self, base: &BaseSample) -> f64 {
        self.planes(base)
            .iter()
            .enumerate()
            .skip(1)
            .map(|(j, plane)| {
                let joints: f64 =
                    plane.joints.iter().map(|joint| joint.velocity.norm_squared()).sum();
                0.5 * self.joint_mass(j) * joints
                    + 0.5
                        * self.parameters.plane_mass.at(j - 1)
                        * plane.centre.velocity.norm_squared()
                    + 0.5 * plane.spin.dot(&(self.plane_inertia(j, plane) * plane.spin))
            })
            .sum()
    }

    /// Energy stored in the springs \[J\]; it does not depend on the base.
    pub fn elastic_energy(&self) -> f64 {
        let p = &self.parameters;
        let longitudinal: f64 = self
            .lengths([0.0; 2])
            .iter()
            .enumerate()
            .map(|(spring, length)| {
                0.5 * p.longitudinal_stiffness.at(spring / 4) * (length - p.rest_length).powi(2)
            })
            .sum();
        let transverse: f64 = (1..=self.coordinates.len())
            .flat_map(|j| self.coordinates[j - 1][3..].iter().map(move |r| (j, r)))
            .map(|(j, r)| 0.5 * p.transverse_stiffness.at(j - 1) * (r - p.rest_radius(j)).powi(2))
            .sum();
        longitudinal + transverse
    }

    /// External force on every plane's centre \[N\]: weight less buoyancy, drag and lift.
    pub fn external_forces(&self, base: &BaseSample) -> Vec<Vector3<f64>> {
        self.external_forces_of(&self.planes(base))
    }

    /// Power that the water's drag and lift give to the arm \[W\]; never positive if the drag
    /// coefficient is not negative.
    pub fn hydrodynamic_power(&self, base: &BaseSample) -> f64 {
        let planes = self.planes(base);
        (1..planes.len())
            .map(|j| self.water_force(&planes, j).dot(&planes[j].centre.velocity))
            .sum()
    }

    /// This arm after moving for `time` at constant rates and accelerations: one Euler step.
    fn moved(&self, time: f64, velocity: &[[f64; 7]], acceleration: &[[f64; 7]]) -> Self {
        let mut moved = self.clone();
        for j in 0..moved.coordinates.len() {
            for k in 0..COORDINATES {
                moved.coordinates[j][k] += time * velocity[j][k];
                moved.rates[j][k] += time * acceleration[j][k];
            }
        }
        moved
    }

    /// Positions, velocities and bias accelerations of all planes, the base first.
    fn planes(&self, base: &BaseSample) -> Vec<Plane> {
        let [theta, phi] = base.angle;
        // In the paper's body the base is at rest, wherever it points: what moves, moves relative to it.
        let still = [0.0; 2];
        let [[theta_rate, phi_rate], [theta_acceleration, phi_acceleration]] =
            match self.parameters.base_coupling {
                BaseCoupling::Gravity => [still, still],
                BaseCoupling::Inertial => [base.rate, base.acceleration],
            };
        let hinges = [Vector3::x(), about_x(theta) * Vector3::y()];
        let spin = theta_rate * hinges[0] + phi_rate * hinges[1];
        let spin_bias = theta_acceleration * hinges[0]
            + phi_acceleration * hinges[1]
            + phi_rate * theta_rate * hinges[0].cross(&hinges[1]);
        let origin = Point {
            position: Vector3::zeros(),
            velocity: Vector3::zeros(),
            bias: Vector3::zeros(),
        };
        let mut planes = vec![Plane::new(
            about_x(theta) * about_y(phi),
            [spin, spin_bias],
            origin,
            Vector3::z(),
            hinges,
            [[self.parameters.base_radius; 4], [0.0; 4]],
        )];

        for (q, rate) in self.coordinates.iter().zip(&self.rates) {
            let floor = &planes[planes.len() - 1];
            let n = floor.rotation * Vector3::z();
            let n_rate = floor.spin.cross(&n);
            let n_bias = floor.spin_bias.cross(&n) + floor.spin.cross(&n_rate);
            let centre = Point {
                position: floor.centre.position + q[0] * n,
                velocity: floor.centre.velocity + rate[0] * n + q[0] * n_rate,
                bias: floor.centre.bias + 2.0 * rate[0] * n_rate + q[0] * n_bias,
            };
            // The axis of α is fixed in the floor; that of β turns with the floor and with α.
            let hinges =
                [floor.rotation * Vector3::x(), floor.rotation * about_x(q[1]) * Vector3::y()];
            let between = floor.spin + rate[1] * hinges[0];
            let spin = between + rate[2] * hinges[1];
            let spin_bias = floor.spin_bias
                + rate[1] * floor.spin.cross(&hinges[0])
                + rate[2] * between.cross(&hinges[1]);
            planes.push(Plane::new(
                floor.rotation * about_x(q[1]) * about_y(q[2]),
                [spin, spin_bias],
                centre,
                n,
                hinges,
                [[q[3], q[4], q[5], q[6]], [rate[3], rate[4], rate[5], rate[6]]],
            ));
        }
        planes
    }

    /// What moves with every joint of plane `j`: the transverse spring and a share of the longitudinal
    /// one.
    fn joint_mass(&self, j: usize) -> f64 {
        let p = &self.parameters;
        p.transverse_mass.at(j - 1) + p.longitudinal_mass.at(j - 1) * p.longitudinal_mass_share
    }

    /// A plane's inertia tensor about its centre, without the joint masses, world frame.
    fn plane_inertia(&self, j: usize, plane: &Plane) -> Matrix3<f64> {
        let inertia = self.parameters.plane_inertia.at(j - 1);
        let local = Matrix3::from_diagonal(&Vector3::new(inertia, inertia, 2.0 * inertia));
        plane.rotation * local * plane.rotation.transpose()
    }

    /// Mean radius of a plane.
    fn mean_radius(&self, plane: usize) -> f64 {
        if plane == 0 {
            self.parameters.base_radius
        } else {
            self.coordinates[plane - 1][3..].iter().sum::<f64>() / 4.0
        }
    }

    /// Volume of compartment `j`.
    fn volume(&self, j: usize) -> f64 {
        let (floor, ceiling) = (self.mean_radius(j - 1), self.mean_radius(j));
        PI * self.coordinates[j - 1][0] / 3.0 * (floor.powi(2) + floor * ceiling + ceiling.powi(2))
    }

    /// Drag and lift on compartment `j`, Eqs. 12–15.
    fn water_force(&self, planes: &[Plane], j: usize) -> Vector3<f64> {
        let p = &self.parameters;
        let velocity = planes[j].centre.velocity;
        let speed = velocity.norm();
        if speed == 0.0 {
            return Vector3::zeros();
        }
        let axis = planes[j].slide;
        let along = velocity.dot(&axis);
        let normal_part = velocity - along * axis;
        let degrees = normal_part.norm().atan2(along.abs()).to_degrees();

        let shape = match p.reference_area {
            ReferenceArea::Wetted => PI,
            ReferenceArea::Planform => 1.0,
        };
        let radii = self.mean_radius(j - 1) + self.mean_radius(j);
        let area = p.area_scale * shape * radii * self.coordinates[j - 1][0];
        let pressure = 0.5 * p.water_density * area;

        let drag = -pressure * polynomial(&p.drag_coefficients, degrees) * speed * velocity;
        let heading = velocity / speed;
        let across = -normal_part;
        let across = across - across.dot(&heading) * heading;
        if across.norm() <= LIFT_DEGENERACY * speed {
            return drag;
        }
        let lift = p.lift_scale * pressure * polynomial(&p.lift_coefficients, degrees);
        drag + lift * speed * speed * across.normalize()
    }

    fn external_forces_of(&self, planes: &[Plane]) -> Vec<Vector3<f64>> {
        let p = &self.parameters;
        let gravity = Vector3::from(p.gravity);
        (1..planes.len())
            .map(|j| {
                let weight = (p.arm_density - p.water_density) * self.volume(j) * gravity;
                weight + self.water_force(planes, j)
            })
            .collect()
    }

    /// All forces on the joint masses and the planes' centres; entry 0 is what the base takes up.
    fn loads(&self, planes: &[Plane]) -> Vec<Loads> {
        let p = &self.parameters;
        let none = Loads { joints: [Vector3::zeros(); 4], centre: Vector3::zeros() };
        let mut loads = vec![none; planes.len()];
        for (index, external) in self.external_forces_of(planes).into_iter().enumerate() {
            let j = index + 1;
            let (floor, ceiling) = (&planes[j - 1], &planes[j]);
            let springs: [Spring; 4] =
                std::array::from_fn(|i| spring(&floor.joints[i], &ceiling.joints[i]));
            // What every spring does by itself, pushing positive.
            let longitudinal: [f64; 4] = std::array::from_fn(|i| {
                -p.longitudinal_stiffness.at(index) * (springs[i].length - p.rest_length)
                    - p.longitudinal_damping.at(index) * springs[i].rate
            });
            let transverse: [f64; 4] = std::array::from_fn(|i| {
                let stretch = self.coordinates[index][3 + i] - p.rest_radius(j);
                -p.transverse_stiffness.at(index) * stretch
                    - p.transverse_damping.at(index) * self.rates[index][3 + i]
            });

            // Eqs. 7 and 8.
            let muscle = &self.longitudinal_muscles[index];
            let transverse_muscle = &self.transverse_muscles[index];
            let excess = self.volume(j) - p.rest_volume(index);
            let constraint: [f64; 4] = std::array::from_fn(|i| {
                let force = match p.volume_force {
                    VolumeForce::Applied => transverse_muscle[i],
                    VolumeForce::Total => transverse_muscle[i] + transverse[i],
                };
                -p.longitudinal_volume_gain * force.abs() * excess
            });
            let sum: f64 = (0..4)
                .map(|i| match p.volume_force {
                    VolumeForce::Applied => muscle[i] + constraint[i],
                    VolumeForce::Total => muscle[i] + longitudinal[i],
                })
                .sum();
            let axial = sum + external.dot(&ceiling.slide);
            let transverse_constraint = -p.transverse_volume_gain * axial.abs() * excess;

            for i in 0..4 {
                let push = longitudinal[i] + muscle[i] + constraint[i];
                loads[j].joints[i] += push * springs[i].direction;
                loads[j - 1].joints[i] -= push * springs[i].direction;
                let radial = transverse[i] + transverse_muscle[i] + transverse_constraint;
                loads[j].joints[i] += radial * ceiling.outward[i];
                loads[j].centre -= radial * ceiling.outward[i];
            }
            loads[j].centre += external;
        }
        loads
    }
}

/// Rotation about the x axis.
fn about_x(angle: f64) -> Matrix3<f64> {
    let (s, c) = angle.sin_cos();
    Matrix3::new(1.0, 0.0, 0.0, 0.0, c, -s, 0.0, s, c)
}

/// Rotation about the y axis.
fn about_y(angle: f64) -> Matrix3<f64> {
    let (s, c) = angle.sin_cos();
    Matrix3::new(c, 0.0, s, 0.0, 1.0, 0.0, -s, 0.0, c)
}

/// Value of a polynomial, highest power first.
fn polynomial(coefficients: &[f64; 5], x: f64) -> f64 {
    let [e1, e2, e3, e4, e5] = *coefficients;
    e1 * x.powi(4) + e2 * x.powi(3) + e3 * x.powi(2) + e4 * x + e5
}

/// The spring between two joints.
fn spring(floor: &Point, ceiling: &Point) -> Spring {
    let between = ceiling.position - floor.position;
    let length = between.norm();
    let direction = between / length;
    Spring { length, rate: direction.dot(&(ceiling.velocity - floor.velocity)), direction }
}

/// Jacobian of a point fixed to plane `j`: only the struts and hinges at or below it move it.
fn carried(planes: &[Plane], j: usize, position: &Vector3<f64>) -> Vec<Column> {
    let mut columns = Vec::with_capacity(3 * j + 1);
    for (index, plane) in planes[1..=j].iter().enumerate() {
        let arm = position - plane.centre.position;
        columns.push((COORDINATES * index, plane.slide));
        columns.push((COORDINATES * index + 1, plane.hinges[0].cross(&arm)));
        columns.push((COORDINATES * index + 2, plane.hinges[1].cross(&arm)));
    }
    columns
}

/// Jacobian of plane `j`'s rotation.
fn turned(planes: &[Plane], j: usize) -> Vec<Column> {
    let mut columns = Vec::with_capacity(2 * j);
    for (index, plane) in planes[1..=j].iter().enumerate() {
        columns.push((COORDINATES * index + 1, plane.hinges[0]));
        columns.push((COORDINATES * index + 2, plane.hinges[1]));
    }
    columns
}

/// Adds `Jᵀ F` to the generalised force.
fn project(columns: &[Column], force: &Vector3<f64>, generalised: &mut DVector<f64>) {
    for (index, column) in columns {
        generalised[*index] += column.dot(force);
    }
}

/// Adds the lower triangle of `Jᵀ I J` to the mass matrix; the columns ascend.
fn accumulate(columns: &[Column], inertia: &Matrix3<f64>, mass_matrix: &mut DMatrix<f64>) {
    for (place, (column, right)) in columns.iter().enumerate() {
        let momentum = inertia * right;
        for (row, left) in &columns[place..] {
            mass_matrix[(*row, *column)] += left.dot(&momentum);
        }
    }
}
