//! The equations of motion in the shape that runs fast.
//!
//! Everything is computed in body frames, compartment by compartment, with the strut's joint split
//! into three elementary ones (prismatic along z, revolute about x, revolute about y), so that a
//! joint's inertia is a number and a change of frame a plane rotation. The work is split into passes,
//! each a straight line of arithmetic without data-dependent branches:
//!
//! | part | pass | runs | gives |
//! |---|---|---|---|
//! | [`outward`] | [`trigonometry`] | every compartment by itself | sines and cosines of α, β |
//! | | [`kinematics`] | base to tip | velocities, and accelerations that would arise with q̈ = 0 |
//! | | [`water`] | by itself | gravity, buoyancy, drag, lift (Eqs. 9–15), volume |
//! | [`inward`] | [`springs`] | by itself | spring and volume forces (Eqs. 1–4, 7–8) |
//! | | [`plane`] | by itself | inertia and bias of a plane with its four joint masses (Eqs. 5–6) |
//! | | [`articulated::inward`] | tip to base | articulated-body inertias |
//! | [`accelerations`] | [`articulated::outward`] | base to tip | the accelerations q̈ |
//!
//! # Layout
//! Quantities are kept in rows of [`WIDTH`] slots. Slot `j · L + lane` of a body with `L` lanes holds
//! compartment `j` of arm `lane`: with `L = 1` a row holds eight neighbouring compartments of one
//! arm, with `L = WIDTH` one compartment of eight arms. Passes that treat compartments by themselves
//! do not see the difference; the three that walk along the arm are generic over `L`.
//!
//! # Order
//! What bounds the speed is not the number of operations but the waits in chains of dependent ones.
//! So passes that are one long chain are interleaved with work that is independent of them: the
//! inward sweep of a chunk with the springs of the next, the accelerations of a Runge–Kutta stage with
//! the velocities and water of the next stage, a few chunks at a time ([`BLOCK`]). The order of the
//! passes changes no bits. All that is written and read again is aligned to a cache line.
//!
//! # Bits
//! Fused multiply-adds are written out (the compiler contracts nothing by itself) and no function of
//! the platform's mathematical library is called, so the result is the same to the bit on every
//! machine and for every instruction set.

use std::ops::Range;

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

    /// The four radii, or their rates.
    #[inline(always)]
    fn radii(&self) -> &[Row; 4] {
        let [_, _, _, radii @ ..] = &self.0;
        radii
    }
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
    /// The rows of `L` arms: slot `k` belongs to arm `k % L`.
    pub(crate) fn new<const L: usize>(arms: &[&ArmParameters; L]) -> Self {
        let row = |value: fn(&ArmParameters) -> f64| lane_row::<L>(arms, value);
        let coefficients = |values: fn(&ArmParameters) -> &[f64; 5]| {
            std::array::from_fn(|term| std::array::from_fn(|slot| values(arms[slot % L])[term]))
        };
        Self {
            rest_length: row(|arm| arm.rest_length),
            longitudinal_stiffness: row(|arm| arm.longitudinal_stiffness),
            longitudinal_damping: row(|arm| arm.longitudinal_damping),
            transverse_stiffness: row(|arm| arm.transverse_stiffness),
            transverse_damping: row(|arm| arm.transverse_damping),
            longitudinal_volume_gain: row(|arm| arm.longitudinal_volume_gain),
            transverse_volume_gain: row(|arm| arm.transverse_volume_gain),
            total: row(total_share),
            applied: row(|arm| 1.0 - total_share(arm)),
            joint_mass: row(ArmParameters::joint_mass),
            inverse_joint_mass: row(|arm| 1.0 / arm.joint_mass()),
            plane_mass: row(|arm| arm.plane_mass),
            plane_inertia: row(|arm| arm.plane_inertia),
            net_density: row(|arm| arm.arm_density - arm.water_density),
            pressure_area: row(|arm| {
                let shape = match arm.reference_area {
                    ReferenceArea::Wetted => std::f64::consts::PI,
                    ReferenceArea::Planform => 1.0,
                };
                0.5 * arm.water_density * arm.area_scale * shape
            }),
            lift_scale: row(|arm| arm.lift_scale),
            drag_coefficients: coefficients(|arm| &arm.drag_coefficients),
            lift_coefficients: coefficients(|arm| &arm.lift_coefficients),
        }
    }
}

/// A parameter of `L` arms as a row: slot `k` belongs to arm `k % L`.
pub(crate) fn lane_row<const L: usize>(
    arms: &[&ArmParameters; L],
    value: fn(&ArmParameters) -> f64,
) -> Row {
    std::array::from_fn(|slot| value(arms[slot % L]))
}

fn total_share(parameters: &ArmParameters) -> f64 {
    match parameters.volume_force {
        VolumeForce::Applied => 0.0,
        VolumeForce::Total => 1.0,
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

/// Squared lengths of a chunk's four longitudinal springs \[m²\]; the root is taken when somebody
/// asks.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(crate) struct Lengths(pub(crate) [Row; 4]);

impl Lengths {
    pub(crate) const ZERO: Self = Self([[0.0; WIDTH]; 4]);
}

/// Radii of a compartment's floor: the ceiling of the one before, or the base.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(crate) struct Floor {
    pub(crate) radius: [Row; 4],
    pub(crate) rate: [Row; 4],
}

/// A [`Floor`] wherever it stands.
#[derive(Clone, Copy)]
pub(crate) struct FloorRef<'a> {
    pub(crate) radius: &'a [Row; 4],
    pub(crate) rate: &'a [Row; 4],
}

impl Floor {
    pub(crate) const ZERO: Self = Self { radius: [[0.0; WIDTH]; 4], rate: [[0.0; WIDTH]; 4] };
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

/// Where compartment `j` of a body with `L` lanes lives: chunk, and slot of its first lane.
#[inline(always)]
pub(crate) const fn place<const L: usize>(compartment: usize) -> (usize, usize) {
    let flat = compartment * L;
    (flat / WIDTH, flat % WIDTH)
}

/// What the sweeps need of a chunk, beside its state.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(crate) struct Link {
    angles: trigonometry::Angles,
    motion: kinematics::Motion,
    external: water::External,
    radial: [Row; 4],
    joints: articulated::Joints,
}

impl Link {
    const ZERO: Self = Self {
        angles: trigonometry::Angles::ZERO,
        motion: kinematics::Motion::ZERO,
        external: water::External::ZERO,
        radial: [[0.0; WIDTH]; 4],
        joints: articulated::Joints::ZERO,
    };
}

/// Chunks that a pass goes through before the next one follows: several, so that the processor fills
/// the waits in one chunk's chains of dependent operations with the next chunk's; not all, so that
/// what a pass hands to the next stays in the nearest cache.
pub(crate) const BLOCK: usize = 3;

/// Intermediate results of one evaluation, kept from call to call.
#[derive(Clone, Debug)]
pub(crate) struct Workspace {
    links: Vec<Link>,
    /// Where floors are gathered; none for lanes, which need no gathering.
    floors: Vec<Floor>,
    scratch: Box<Scratch>,
}

/// What one pass hands to the next within a block or from one chunk to the next; in the same place
/// every time, so that it stays in the nearest cache.
#[derive(Clone, Debug)]
struct Scratch {
    flows: [kinematics::Flow; BLOCK],
    top: springs::Top,
    /// Of this chunk and of the one further from the base, in turns.
    bottoms: [springs::Bottom; 2],
    gathered: springs::Bottom,
    plane: plane::Plane,
}

impl Workspace {
    /// Number of chunks.
    #[inline(always)]
    pub(crate) fn len(&self) -> usize {
        self.links.len()
    }

    /// What [`Workspace::new`] asks for on the heap.
    pub(crate) fn bytes<const L: usize>(chunks: usize) -> usize {
        let floor = if L < WIDTH { size_of::<Floor>() } else { 0 };
        chunks * (size_of::<Link>() + floor) + size_of::<Scratch>()
    }

    pub(crate) fn new<const L: usize>(chunks: usize) -> Self {
        Self {
            links: vec![Link::ZERO; chunks],
            floors: vec![Floor::ZERO; if L < WIDTH { chunks } else { 0 }],
            scratch: Box::new(Scratch {
                flows: [kinematics::Flow::ZERO; BLOCK],
                top: springs::Top::ZERO,
                bottoms: [springs::Bottom::ZERO; 2],
                gathered: springs::Bottom::ZERO,
                plane: plane::Plane::ZERO,
            }),
        }
    }
}

/// What an evaluation reads and does not change.
#[derive(Clone, Debug)]
pub(crate) struct Body<const L: usize> {
    pub(crate) compartments: usize,
    /// A chunk that ends with the base planes, as if they were compartments of their own.
    pub(crate) base: Box<Block>,
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

/// The chunk that holds the compartments one nearer the base than the first of chunk `c`.
#[inline(always)]
fn before<'a, const L: usize>(
    body: &'a Body<L>,
    coordinates: &'a [Block],
    rates: &'a [Block],
    c: usize,
) -> (&'a Block, &'a Block) {
    match c.checked_sub(1) {
        None => (&body.base, &Block::ZERO),
        Some(before) => (&coordinates[before], &rates[before]),
    }
}

/// The radii of chunk `c`'s floors, one compartment nearer the base, and their rates: gathered into
/// `place`, unless they stand in neighbouring slots of one chunk anyway.
#[inline(always)]
fn gather_floor<'a, const L: usize>(
    body: &'a Body<L>,
    coordinates: &'a [Block],
    rates: &'a [Block],
    c: usize,
    place: &'a mut [Floor],
) -> FloorRef<'a> {
    if L < WIDTH {
        let (radii, radius_rates) = before::<L>(body, coordinates, rates, c);
        for i in 0..4 {
            let (radius, rate) = (&coordinates[c].0[3 + i], &rates[c].0[3 + i]);
            shift_outward::<L>(&radii.0[3 + i], radius, &mut place[c].radius[i]);
            shift_outward::<L>(&radius_rates.0[3 + i], rate, &mut place[c].rate[i]);
        }
    }
    gathered_floor::<L>(body, coordinates, rates, c, place)
}

/// What [`gather_floor`] gave.
#[inline(always)]
fn gathered_floor<'a, const L: usize>(
    body: &'a Body<L>,
    coordinates: &'a [Block],
    rates: &'a [Block],
    c: usize,
    place: &'a [Floor],
) -> FloorRef<'a> {
    if L < WIDTH {
        return FloorRef { radius: &place[c].radius, rate: &place[c].rate };
    }
    let (radii, radius_rates) = before::<L>(body, coordinates, rates, c);
    FloorRef { radius: radii.radii(), rate: radius_rates.radii() }
}

/// Squared lengths of a chunk's longitudinal springs. Leaves the sines and cosines of its joints in the
/// workspace.
#[inline(always)]
pub(crate) fn spring_lengths<const L: usize>(
    body: &Body<L>,
    coordinates: &[Block],
    rates: &[Block],
    c: usize,
    workspace: &mut Workspace,
    lengths: &mut Lengths,
) {
    let Workspace { links, floors, .. } = workspace;
    let floor = gather_floor::<L>(body, coordinates, rates, c, floors);
    let angles = &mut links[c].angles;
    trigonometry::angles(&coordinates[c], angles);
    springs::squared_lengths(&coordinates[c], angles, floor, &mut lengths.0);
}

/// First part of an evaluation, for the chunks `block` (at most [`BLOCK`]): velocities and water,
/// base to tip. `travel` goes on from block to block.
///
/// `coordinates` and `rates` hold one block a chunk. Slots beyond the last compartment must hold a
/// state at rest.
#[inline(always)]
pub(crate) fn outward<const L: usize>(
    body: &Body<L>,
    travel: &mut kinematics::Travel<L>,
    coordinates: &[Block],
    rates: &[Block],
    block: Range<usize>,
    trigonometry_known: bool,
    workspace: &mut Workspace,
) {
    let Workspace { links, floors, scratch } = workspace;
    let flows = &mut scratch.flows;
    let first = block.start;
    let chunks = links.len();
    assert!(block.end <= chunks && block.len() <= BLOCK && body.rest.len() == chunks);
    assert!(coordinates.len() == chunks && rates.len() == chunks);
    if !trigonometry_known {
        for c in block.clone() {
            trigonometry::angles(&coordinates[c], &mut links[c].angles);
        }
    }
    for c in block.clone() {
        let Link { angles, motion, .. } = &mut links[c];
        kinematics::outward::<L>(
            in_chunk::<L>(body.compartments, c),
            travel,
            &coordinates[c],
            &rates[c],
            angles,
            motion,
            &mut flows[c - first],
        );
    }
    for c in block {
        water::external(
            &body.material,
            &body.rest[c],
            &coordinates[c],
            gather_floor::<L>(body, coordinates, rates, c, floors),
            &flows[c - first],
            &mut links[c].external,
        );
    }
}

/// Second part of an evaluation: springs, planes and the inward sweep, tip to base.
#[inline(always)]
pub(crate) fn inward<const L: usize>(
    body: &Body<L>,
    coordinates: &[Block],
    rates: &[Block],
    muscles: &[Muscles],
    workspace: &mut Workspace,
) {
    let Workspace { links, floors, scratch } = workspace;
    let chunks = links.len();
    assert!(body.rest.len() == chunks && muscles.len() == chunks);
    assert!(coordinates.len() == chunks && rates.len() == chunks);
    let Scratch { top, bottoms, gathered, plane, .. } = &mut **scratch;
    // The inward sweep is one long chain of dependent operations. The forces of the next chunk fill
    // its waits, and it theirs.
    let mut carried = articulated::Carried::TIP;
    bottoms[chunks % 2] = springs::Bottom::ZERO;
    for c in (0..=chunks).rev() {
        if let Some(c) = c.checked_sub(1) {
            let bottom = &mut bottoms[c % 2];
            springs::forces(
                &body.material,
                &body.rest[c],
                &muscles[c],
                &coordinates[c],
                &rates[c],
                &links[c].angles,
                gathered_floor::<L>(body, coordinates, rates, c, floors),
                &links[c].external,
                top,
                bottom,
            );
            if c + 1 == chunks {
                clear_beyond_tip::<L>(body.compartments, bottom);
            }
        }
        if c < chunks {
            articulated::inward::<L>(
                in_chunk::<L>(body.compartments, c),
                &mut carried,
                &body.material,
                &coordinates[c],
                plane,
                &mut links[c],
            );
        }
        if let Some(c) = c.checked_sub(1) {
            let Link { motion, radial, .. } = &mut links[c];
            let above = springs::above::<L>(&bottoms[c % 2], &bottoms[(c + 1) % 2], gathered);
            let (q, u) = (&coordinates[c], &rates[c]);
            plane::assemble(&body.material, q, u, motion, top, above, plane, radial);
        }
    }
}

/// Last part of an evaluation: accelerations of chunk `c`, base to tip. `travel` goes on from chunk
/// to chunk.
#[inline(always)]
pub(crate) fn accelerations<const L: usize>(
    body: &Body<L>,
    coordinates: &Block,
    c: usize,
    travel: &mut articulated::Travel<L>,
    workspace: &Workspace,
    out: &mut Block,
) {
    let slots = in_chunk::<L>(body.compartments, c);
    let beyond = slots.end;
    articulated::outward::<L>(slots, travel, coordinates, &workspace.links[c], out);
    // What lies beyond the tip stays at rest.
    if L < WIDTH {
        for row in &mut out.0 {
            for k in beyond..WIDTH {
                row[k] = 0.0;
            }
        }
    }
}

/// First slots of the compartments of chunk `c`.
#[inline(always)]
fn in_chunk<const L: usize>(compartments: usize, c: usize) -> Range<usize> {
    0..WIDTH.min((compartments - c * (WIDTH / L)) * L)
}

/// The springs of the slots beyond the last compartment pull on nothing.
#[inline(always)]
fn clear_beyond_tip<const L: usize>(compartments: usize, bottom: &mut springs::Bottom) {
    let (_, slot) = place::<L>(compartments);
    if slot > 0 {
        for row in &mut bottom.0 {
            row[slot..].fill(0.0);
        }
    }
}
