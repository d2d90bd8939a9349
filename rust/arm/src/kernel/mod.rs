//! The equations of motion in the shape that runs fast.
//!
//! Everything is computed in body frames, compartment by compartment, with the strut's joint split
//! into three elementary ones (prismatic along z, revolute about x, revolute about y), so that a
//! joint's inertia is a number and a change of frame a plane rotation. The work is split into passes,
//! each a straight line of arithmetic without data-dependent branches:
//!
//! | pass | runs | gives |
//! |---|---|---|
//! | [`trigonometry`] | every compartment by itself | sines and cosines of α, β |
//! | [`kinematics`] | base to tip | velocities, and accelerations that would arise with q̈ = 0 |
//! | [`water`] | by itself | gravity, buoyancy, drag, lift (Eqs. 9–15), volume |
//! | [`springs`] | by itself | spring and volume forces (Eqs. 1–4, 7–8) |
//! | [`plane`] | by itself | inertia and bias of a plane with its four joint masses (Eqs. 5–6) |
//! | [`articulated::inward`] | tip to base | articulated-body inertias |
//! | [`articulated::outward`] | base to tip | the accelerations q̈ |
//!
//! # Layout
//! Quantities are kept in rows of [`WIDTH`] slots. Slot `j · L + lane` of a body with `L` lanes holds
//! compartment `j` of arm `lane`: with `L = 1` a row holds eight neighbouring compartments of one
//! arm, with `L = WIDTH` one compartment of eight arms. Passes that treat compartments by themselves
//! do not see the difference; the three that walk along the arm are generic over `L`.
//!
//! # Bits
//! Fused multiply-adds are written out (the compiler contracts nothing by itself) and no function of
//! the platform's mathematical library is called, so the result is the same to the bit on every
//! machine and for every instruction set.

pub(crate) mod articulated;
pub(crate) mod kinematics;
pub(crate) mod plane;
pub(crate) mod springs;
pub(crate) mod trigonometry;
pub(crate) mod water;

use crate::parameters::{ArmParameters, ReferenceArea, VolumeForce};
use crate::state::COORDINATES;

/// Slots in a row: one AVX-512 register of doubles.
pub(crate) const WIDTH: usize = 8;

/// One quantity in [`WIDTH`] slots.
pub(crate) type Row = [f64; WIDTH];

/// Coordinates, rates or accelerations of a chunk: `[h, α, β, r1, r2, r3, r4]`.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(crate) struct Block(pub(crate) [Row; COORDINATES]);

impl Block {
    pub(crate) const ZERO: Self = Self([[0.0; WIDTH]; COORDINATES]);
}

/// Parameters that are the same for every compartment of an arm, one row each.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(crate) struct Material {
    pub(crate) rest_length: Row,
    pub(crate) longitudinal_stiffness: Row,
    pub(crate) longitudinal_damping: Row,
    pub(crate) transverse_stiffness: Row,
    pub(crate) transverse_damping: Row,
    pub(crate) longitudinal_volume_gain: Row,
    pub(crate) transverse_volume_gain: Row,
    /// 1 for [`VolumeForce::Total`], else 0.
    pub(crate) total: Row,
    /// 1 − `total`.
    pub(crate) applied: Row,
    pub(crate) joint_mass: Row,
    pub(crate) inverse_joint_mass: Row,
    pub(crate) plane_mass: Row,
    pub(crate) plane_inertia: Row,
    /// `ρ_o − ρ_w`, Eq. 10.
    pub(crate) net_density: Row,
    /// `½ ρ_w A_r / ((R_b + R_t) h)`.
    pub(crate) pressure_area: Row,
    pub(crate) lift_scale: Row,
    pub(crate) drag_coefficients: [Row; 5],
    pub(crate) lift_coefficients: [Row; 5],
}

impl Material {
    pub(crate) fn new(parameters: &ArmParameters) -> Self {
        let row = |value: f64| [value; WIDTH];
        let shape = match parameters.reference_area {
            ReferenceArea::Wetted => std::f64::consts::PI,
            ReferenceArea::Planform => 1.0,
        };
        let total = match parameters.volume_force {
            VolumeForce::Applied => 0.0,
            VolumeForce::Total => 1.0,
        };
        Self {
            rest_length: row(parameters.rest_length),
            longitudinal_stiffness: row(parameters.longitudinal_stiffness),
            longitudinal_damping: row(parameters.longitudinal_damping),
            transverse_stiffness: row(parameters.transverse_stiffness),
            transverse_damping: row(parameters.transverse_damping),
            longitudinal_volume_gain: row(parameters.longitudinal_volume_gain),
            transverse_volume_gain: row(parameters.transverse_volume_gain),
            total: row(total),
            applied: row(1.0 - total),
            joint_mass: row(parameters.joint_mass()),
            inverse_joint_mass: row(1.0 / parameters.joint_mass()),
            plane_mass: row(parameters.plane_mass),
            plane_inertia: row(parameters.plane_inertia),
            net_density: row(parameters.arm_density - parameters.water_density),
            pressure_area: row(0.5 * parameters.water_density * parameters.area_scale * shape),
            lift_scale: row(parameters.lift_scale),
            drag_coefficients: parameters.drag_coefficients.map(row),
            lift_coefficients: parameters.lift_coefficients.map(row),
        }
    }
}

/// What differs from compartment to compartment and does not move.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(crate) struct Rest {
    /// Rest radius of the ceiling plane.
    pub(crate) radius: Row,
    /// Rest volume.
    pub(crate) volume: Row,
}

/// Muscle inputs of a chunk \[N\]: ξ_c and δ_c of the four springs.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(crate) struct Muscles {
    pub(crate) longitudinal: [Row; 4],
    pub(crate) transverse: [Row; 4],
}

impl Muscles {
    pub(crate) const ZERO: Self =
        Self { longitudinal: [[0.0; WIDTH]; 4], transverse: [[0.0; WIDTH]; 4] };
}

/// Radii of a compartment's floor: the ceiling of the one before, or the base.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(crate) struct Floor {
    pub(crate) radius: [Row; 4],
    pub(crate) rate: [Row; 4],
}

impl Floor {
    pub(crate) const ZERO: Self = Self { radius: [[0.0; WIDTH]; 4], rate: [[0.0; WIDTH]; 4] };
}

/// The base's motion in its own frame, one value a lane.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BaseFrame<const L: usize> {
    /// Angular velocity.
    pub(crate) omega: [[f64; L]; 3],
    /// Angular acceleration.
    pub(crate) psi: [[f64; L]; 3],
    /// Gravity.
    pub(crate) gravity: [[f64; L]; 3],
    /// Base radius.
    pub(crate) radius: [f64; L],
}

/// Where compartment `j` of a body with `L` lanes lives: chunk, and slot of its first lane.
#[inline(always)]
pub(crate) const fn place<const L: usize>(compartment: usize) -> (usize, usize) {
    let flat = compartment * L;
    (flat / WIDTH, flat % WIDTH)
}

/// Intermediate results of one evaluation, kept from call to call.
#[derive(Clone, Debug)]
pub(crate) struct Workspace {
    angles: Vec<trigonometry::Angles>,
    floors: Vec<Floor>,
    motions: Vec<kinematics::Motion>,
    external: Vec<water::External>,
    tops: Vec<springs::Top>,
    /// One more than there are chunks: the last is the absent compartment beyond the tip.
    bottoms: Vec<springs::Bottom>,
    planes: Vec<plane::Plane>,
    joints: Vec<articulated::Joints>,
    pub(crate) accelerations: Vec<Block>,
}

impl Workspace {
    pub(crate) fn new(chunks: usize) -> Self {
        Self {
            angles: vec![trigonometry::Angles::ZERO; chunks],
            floors: vec![Floor::ZERO; chunks],
            motions: vec![kinematics::Motion::ZERO; chunks],
            external: vec![water::External::ZERO; chunks],
            tops: vec![springs::Top::ZERO; chunks],
            bottoms: vec![springs::Bottom::ZERO; chunks + 1],
            planes: vec![plane::Plane::ZERO; chunks],
            joints: vec![articulated::Joints::ZERO; chunks],
            accelerations: vec![Block::ZERO; chunks],
        }
    }
}

/// What an evaluation reads and does not change.
#[derive(Clone, Debug)]
pub(crate) struct Body {
    pub(crate) compartments: usize,
    /// On the heap, like all that asks for 64-byte alignment: an [`crate::Arm`] may be embedded in
    /// memory that a foreign allocator aligned for ordinary numbers only.
    pub(crate) material: Box<Material>,
    pub(crate) rest: Vec<Rest>,
}

/// Moves every slot of `this` outward by one compartment; the first `L` slots come from `before`.
#[inline(always)]
fn shift_outward<const L: usize>(before: &Row, this: &Row, out: &mut Row) {
    for k in 0..WIDTH {
        out[k] = if k < L { before[WIDTH - L + k] } else { this[k - L] };
    }
}

/// Fills `floors` with the radii one compartment nearer the base.
#[inline(always)]
fn gather_floors<const L: usize>(
    base_radius: &[f64; L],
    coordinates: &[Block],
    rates: &[Block],
    floors: &mut [Floor],
) {
    let mut base = [0.0; WIDTH];
    base[WIDTH - L..].copy_from_slice(base_radius);
    for c in 0..coordinates.len() {
        for i in 0..4 {
            let (radius, rate) = if c == 0 {
                (&base, &[0.0; WIDTH])
            } else {
                (&coordinates[c - 1].0[3 + i], &rates[c - 1].0[3 + i])
            };
            shift_outward::<L>(radius, &coordinates[c].0[3 + i], &mut floors[c].radius[i]);
            shift_outward::<L>(rate, &rates[c].0[3 + i], &mut floors[c].rate[i]);
        }
    }
}

/// Lengths of all longitudinal springs, one chunk an entry of `lengths`.
#[inline(always)]
pub(crate) fn spring_lengths<const L: usize>(
    body: &Body,
    base_radius: &[f64; L],
    coordinates: &[Block],
    rates: &[Block],
    workspace: &mut Workspace,
    lengths: &mut [[Row; 4]],
) {
    gather_floors::<L>(base_radius, coordinates, rates, &mut workspace.floors);
    for c in 0..body.rest.len() {
        trigonometry::angles(&coordinates[c], &mut workspace.angles[c]);
        springs::lengths(
            &coordinates[c],
            &workspace.angles[c],
            &workspace.floors[c],
            &mut lengths[c],
        );
    }
}

/// Accelerations of all coordinates, into `workspace.accelerations`.
///
/// `coordinates`, `rates` and `muscles` hold one block a chunk. Slots beyond the last compartment
/// must hold a state at rest; their accelerations stay zero.
#[inline(always)]
pub(crate) fn evaluate<const L: usize>(
    body: &Body,
    base: &BaseFrame<L>,
    coordinates: &[Block],
    rates: &[Block],
    muscles: &[Muscles],
    workspace: &mut Workspace,
) {
    let chunks = body.rest.len();
    let n = body.compartments;
    let w = workspace;
    for c in 0..chunks {
        trigonometry::angles(&coordinates[c], &mut w.angles[c]);
    }
    kinematics::outward::<L>(n, base, coordinates, rates, &w.angles, &mut w.motions);
    gather_floors::<L>(&base.radius, coordinates, rates, &mut w.floors);
    for c in 0..chunks {
        water::external(
            &body.material,
            &body.rest[c],
            &coordinates[c],
            &w.floors[c],
            &w.motions[c],
            &mut w.external[c],
        );
        springs::forces(
            &body.material,
            &body.rest[c],
            &muscles[c],
            &coordinates[c],
            &rates[c],
            &w.angles[c],
            &w.floors[c],
            &w.external[c],
            &mut w.tops[c],
            &mut w.bottoms[c],
        );
    }
    clear_beyond_tip::<L>(n, &mut w.bottoms);
    for c in 0..chunks {
        let above = springs::above::<L>(&w.bottoms, c);
        plane::assemble(
            &body.material,
            &coordinates[c],
            &rates[c],
            &w.motions[c],
            &w.tops[c],
            &above,
            &mut w.planes[c],
        );
    }
    articulated::inward::<L>(
        n,
        &body.material,
        coordinates,
        &w.angles,
        &w.external,
        &w.planes,
        &mut w.joints,
    );
    articulated::outward::<L>(
        n,
        coordinates,
        &w.angles,
        &w.planes,
        &w.joints,
        &mut w.accelerations,
    );
}

/// The springs of the slots beyond the last compartment pull on nothing.
#[inline(always)]
fn clear_beyond_tip<const L: usize>(compartments: usize, bottoms: &mut [springs::Bottom]) {
    let (chunk, slot) = place::<L>(compartments);
    for row in &mut bottoms[chunk].0 {
        for value in &mut row[slot..slot + L] {
            *value = 0.0;
        }
    }
}
