//! The passes of an evaluation in their order, and the scratch memory that they share.

use std::ops::Range;

use super::body::Body;
use super::rows::{Block, Floor, FloorRef, Lengths, Muscles, Row, WIDTH, place, shift_outward};
use super::{articulated, kinematics, plane, springs, water};

/// What the sweeps need of a chunk, beside its state.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
struct Link {
    angles: kinematics::Angles,
    motion: kinematics::Motion,
    external: water::External,
    radial: [Row; 4],
    joints: articulated::Joints,
}

impl Link {
    const ZERO: Self = Self {
        angles: kinematics::Angles::ZERO,
        motion: kinematics::Motion::ZERO,
        external: water::External::ZERO,
        radial: [[0.0; WIDTH]; 4],
        joints: articulated::Joints::ZERO,
    };
}

/// Chunks that a pass goes through before the next one follows: several, so that the processor fills
/// the waits in one chunk's chains of dependent operations with the next chunk's; not all, so that
/// what a pass hands to the next stays in the nearest cache.
pub(crate) const STRETCH: usize = 4;

/// Intermediate results of one evaluation, kept from call to call.
#[derive(Clone, Debug)]
pub(crate) struct Workspace {
    links: Vec<Link>,
    /// Where floors are gathered; none for lanes, which need no gathering.
    floors: Vec<Floor>,
    scratch: Box<Scratch>,
}

/// What one pass hands to the next within a stretch or from one chunk to the next; in the same place
/// every time, so that it stays in the nearest cache.
#[derive(Clone, Debug)]
struct Scratch {
    flows: [kinematics::Flow; STRETCH],
    streams: [water::Stream; STRETCH],
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
                flows: [kinematics::Flow::ZERO; STRETCH],
                streams: [water::Stream::ZERO; STRETCH],
                top: springs::Top::ZERO,
                bottoms: [springs::Bottom::ZERO; 2],
                gathered: springs::Bottom::ZERO,
                plane: plane::Plane::ZERO,
            }),
        }
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
    kinematics::angles(&coordinates[c], angles);
    springs::squared_lengths(&coordinates[c], angles, floor, &mut lengths.0);
}

/// First part of an evaluation, for the chunks `stretch` (at most [`STRETCH`]): velocities and water,
/// base to tip. `travel` goes on from stretch to stretch.
///
/// `coordinates` and `rates` hold one block a chunk. Slots beyond the last compartment must hold a
/// state at rest.
#[inline(always)]
pub(crate) fn outward<const L: usize>(
    body: &Body<L>,
    travel: &mut kinematics::Travel<L>,
    coordinates: &[Block],
    rates: &[Block],
    stretch: Range<usize>,
    trigonometry_known: bool,
    workspace: &mut Workspace,
) {
    let Workspace { links, floors, scratch } = workspace;
    let flows = &mut scratch.flows;
    let first = stretch.start;
    let chunks = links.len();
    assert!(stretch.end <= chunks && stretch.len() <= STRETCH && body.rest.len() == chunks);
    assert!(coordinates.len() == chunks && rates.len() == chunks);
    if !trigonometry_known {
        for c in stretch.clone() {
            kinematics::angles(&coordinates[c], &mut links[c].angles);
        }
    }
    for c in stretch.clone() {
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
    let streams = &mut scratch.streams;
    for c in stretch.clone() {
        water::speeds(
            &body.rest[c],
            &coordinates[c],
            gather_floor::<L>(body, coordinates, rates, c, floors),
            &flows[c - first],
            &mut streams[c - first],
            &mut links[c].external,
        );
    }
    for c in stretch.clone() {
        water::half_angles(&flows[c - first], &mut streams[c - first]);
    }
    for c in stretch {
        let (flow, stream) = (&flows[c - first], &streams[c - first]);
        water::external(body.material(c), &coordinates[c], flow, stream, &mut links[c].external);
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
                body.material(c),
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
            let Link { angles, external, joints, .. } = &mut links[c];
            articulated::inward::<L>(
                in_chunk::<L>(body.compartments, c),
                &mut carried,
                body.material(c),
                &coordinates[c],
                plane,
                angles,
                external,
                joints,
            );
        }
        if let Some(c) = c.checked_sub(1) {
            let Link { motion, radial, .. } = &mut links[c];
            let above = springs::above::<L>(&bottoms[c % 2], &bottoms[(c + 1) % 2], gathered);
            let (q, u) = (&coordinates[c], &rates[c]);
            plane::assemble(body.material(c), q, u, motion, top, above, plane, radial);
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
    let Link { angles, radial, joints, .. } = &workspace.links[c];
    articulated::outward::<L>(slots, travel, coordinates, angles, radial, joints, out);
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
