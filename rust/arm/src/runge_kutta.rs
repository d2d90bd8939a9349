//! The fourth-order Runge–Kutta step over chunks.

use crate::base::{BaseMotion, BaseRows};
use crate::domain::{Bounds, mark_outside};
use crate::instruction_set::{Supported, compiled_for_each_set};
use crate::kernel::{
    BaseFrame, Block, Body, InertiaTravel, Lengths, Material, MotionTravel, Muscles, Rest, Row,
    STRETCH, WIDTH, Workspace, accelerations, inward, lane_row, outward, place, set_lane,
    spring_lengths,
};
use crate::multiply_add::MultiplyAdd;
use crate::parameters::{ArmParameters, BaseCoupling};
use crate::state::COORDINATES;

/// State and scratch memory of `L` arms with the same number of compartments.
#[derive(Clone, Debug)]
pub(crate) struct Integrator<const L: usize> {
    body: Body<L>,
    bounds: Box<Bounds>,
    shares: Box<Shares>,
    gravity: [[f64; L]; 3],
    /// Whether a turning base carries the arm along, [`BaseCoupling::Inertial`].
    carries: [bool; L],
    pub(crate) muscles: Vec<Muscles>,
    coordinates: Vec<Block>,
    rates: Vec<Block>,
    lengths: Vec<Lengths>,
    /// The state that a step is heading for; becomes the state if it lies in the domain.
    next_coordinates: Vec<Block>,
    next_rates: Vec<Block>,
    next_lengths: Vec<Lengths>,
    stage_coordinates: Vec<Block>,
    stage_rates: Vec<Block>,
    workspace: Workspace,
    /// Whether the workspace holds the sines and cosines of the present state.
    trigonometry_known: bool,
}

/// The time step, and its shares in the Runge–Kutta method.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
struct Shares {
    full: Row,
    half: Row,
    third: Row,
    sixth: Row,
}

/// What is made of the accelerations `a` of the first stage: their share of the state that the step heads
/// for, and the second stage's state.
#[inline(always)]
fn first_stage(
    shares: &Shares,
    (q, u): (&Block, &Block),
    a: &Block,
    (next_q, next_u): (&mut Block, &mut Block),
    (stage_q, stage_u): (&mut Block, &mut Block),
) {
    for row in 0..COORDINATES {
        for k in 0..WIDTH {
            let (q, u, a) = (q.0[row][k], u.0[row][k], a.0[row][k]);
            next_q.0[row][k] = shares.sixth[k].madd(u, q);
            next_u.0[row][k] = shares.sixth[k].madd(a, u);
            stage_q.0[row][k] = shares.half[k].madd(u, q);
            stage_u.0[row][k] = shares.half[k].madd(a, u);
        }
    }
}

/// The same for the second and the third stage; the state of the following one, `forward` from the
/// beginning, takes the place of theirs.
#[inline(always)]
fn middle_stage(
    shares: &Shares,
    forward: &Row,
    (q, u): (&Block, &Block),
    a: &Block,
    (next_q, next_u): (&mut Block, &mut Block),
    (stage_q, stage_u): (&mut Block, &mut Block),
) {
    for row in 0..COORDINATES {
        for k in 0..WIDTH {
            let (rate, a) = (stage_u.0[row][k], a.0[row][k]);
            next_q.0[row][k] = shares.third[k].madd(rate, next_q.0[row][k]);
            next_u.0[row][k] = shares.third[k].madd(a, next_u.0[row][k]);
            stage_q.0[row][k] = forward[k].madd(rate, q.0[row][k]);
            stage_u.0[row][k] = forward[k].madd(a, u.0[row][k]);
        }
    }
}

/// The same for the last stage, which none follows.
#[inline(always)]
fn last_stage(shares: &Shares, stage_u: &Block, a: &Block, next_q: &mut Block, next_u: &mut Block) {
    for row in 0..COORDINATES {
        for k in 0..WIDTH {
            next_q.0[row][k] = shares.sixth[k].madd(stage_u.0[row][k], next_q.0[row][k]);
            next_u.0[row][k] = shares.sixth[k].madd(a.0[row][k], next_u.0[row][k]);
        }
    }
}

/// Copies the slots of the given lanes.
fn merge<const L: usize>(lanes: &[bool; L], from: &Row, to: &mut Row) {
    for slot in 0..WIDTH {
        if lanes[slot % L] {
            to[slot] = from[slot];
        }
    }
}

impl<const L: usize> Integrator<L> {
    /// Arms at rest with every spring at its rest length.
    ///
    /// # Panics
    /// If their numbers of compartments differ.
    pub(crate) fn new(arms: &[&ArmParameters; L]) -> Self {
        let n = arms[0].compartments;
        assert!(arms.iter().all(|arm| arm.compartments == n), "lanes of one shape");
        let chunks = (n * L).div_ceil(WIDTH);
        // Slots beyond the tip hold a compartment like the last.
        let compartment = |chunk: usize, slot: usize| ((chunk * WIDTH + slot) / L).min(n - 1);
        let by_slot = |value: &dyn Fn(&ArmParameters, usize) -> f64, chunk: usize| -> Row {
            std::array::from_fn(|slot| value(arms[slot % L], compartment(chunk, slot)))
        };
        let mut rest = Vec::with_capacity(chunks);
        let mut at_rest = Vec::with_capacity(chunks);
        for chunk in 0..chunks {
            let radius = by_slot(&|arm, j| arm.rest_radius(j + 1), chunk);
            rest.push(Rest { radius, volume: by_slot(&|arm, j| arm.rest_volume(j), chunk) });
            let mut block = Block::ZERO;
            block.0[0] = by_slot(&|arm, _| arm.rest_height(), chunk);
            block.0[3..].fill(radius);
            at_rest.push(block);
        }
        let row = |value| lane_row::<L>(arms, value);
        let mut base = Block::ZERO;
        base.0[3..].fill(row(|arm| arm.base_radius));
        let mut integrator = Self {
            body: Body::new(arms, base, rest, compartment),
            bounds: Box::new(Bounds::new(arms)),
            shares: Box::new(Shares {
                full: row(|arm| arm.timestep),
                half: row(|arm| 0.5 * arm.timestep),
                third: row(|arm| arm.timestep / 3.0),
                sixth: row(|arm| arm.timestep / 6.0),
            }),
            gravity: [0, 1, 2].map(|axis| arms.map(|arm| arm.gravity[axis])),
            carries: arms.map(|arm| arm.base_coupling == BaseCoupling::Inertial),
            muscles: vec![Muscles::ZERO; chunks],
            rates: vec![Block::ZERO; chunks],
            lengths: vec![Lengths::ZERO; chunks],
            next_coordinates: at_rest.clone(),
            next_rates: vec![Block::ZERO; chunks],
            next_lengths: vec![Lengths::ZERO; chunks],
            stage_coordinates: at_rest.clone(),
            stage_rates: vec![Block::ZERO; chunks],
            workspace: Workspace::new::<L>(chunks),
            trigonometry_known: false,
            coordinates: at_rest,
        };
        refresh(Supported::detected(), &mut integrator, ());
        integrator
    }

    /// Gives a lane the body of an arm alone, with as many compartments; its state must be set next.
    pub(crate) fn set_body(&mut self, lane: usize, alone: &Integrator<1>) {
        self.body.set_lane(lane, &alone.body);
        self.bounds.set_lane::<L>(lane, &alone.bounds);
        let Shares { full, half, third, sixth } = &mut *self.shares;
        for (row, alone) in [
            (full, &alone.shares.full),
            (half, &alone.shares.half),
            (third, &alone.shares.third),
            (sixth, &alone.shares.sixth),
        ] {
            set_lane::<L>(row, lane, alone);
        }
        for (row, alone) in self.gravity.iter_mut().zip(alone.gravity) {
            row[lane] = alone[0];
        }
        self.carries[lane] = alone.carries[0];
    }

    /// What [`Integrator::new`] asks for on the heap \[bytes\], and a quarter more for the allocator.
    pub(crate) fn bytes(compartments: usize) -> usize {
        let chunks = (compartments * L).div_ceil(WIDTH);
        let state = 3 * 2 * size_of::<Block>() + 2 * size_of::<Lengths>() + size_of::<Muscles>();
        let once = size_of::<Block>() + size_of::<Bounds>();
        let sum = chunks * (state + size_of::<Material>() + size_of::<Rest>())
            + once
            + size_of::<Shares>()
            + Workspace::bytes::<L>(chunks);
        sum / 4 * 5
    }

    /// Entry `index` of compartment `j`'s coordinates.
    pub(crate) fn coordinate(&self, lane: usize, j: usize, index: usize) -> f64 {
        let (chunk, slot) = place::<L>(j);
        self.coordinates[chunk].0[index][slot + lane]
    }

    /// Entry `index` of compartment `j`'s rates.
    pub(crate) fn rate(&self, lane: usize, j: usize, index: usize) -> f64 {
        let (chunk, slot) = place::<L>(j);
        self.rates[chunk].0[index][slot + lane]
    }

    /// Length of spring `i` of compartment `j`.
    pub(crate) fn length(&self, lane: usize, j: usize, i: usize) -> f64 {
        let (chunk, slot) = place::<L>(j);
        self.lengths[chunk].0[i][slot + lane].sqrt()
    }

    /// Writes the lengths of an arm's springs, compartment by compartment.
    pub(crate) fn lengths_into(&self, lane: usize, out: &mut [f64]) {
        let (out, _) = out.as_chunks_mut::<4>();
        for (out, squares) in out.chunks_mut(WIDTH / L).zip(&self.lengths) {
            // The slots of this lane in the chunk, one a compartment.
            let mut roots = [[0.0; WIDTH]; 4];
            for i in 0..4 {
                for (root, k) in roots[i].iter_mut().zip((lane..WIDTH).step_by(L)) {
                    *root = squares.0[i][k].sqrt();
                }
            }
            for (j, lengths) in out.iter_mut().enumerate() {
                *lengths = [roots[0][j], roots[1][j], roots[2][j], roots[3][j]];
            }
        }
    }

    /// What [`Integrator::coordinate`], [`Integrator::rate`] and [`Integrator::length`] would be after the step
    /// that [`Integrator::advance`] has just refused.
    pub(crate) fn refused(
        &self,
        lane: usize,
        j: usize,
    ) -> ([f64; COORDINATES], [f64; COORDINATES], [f64; 4]) {
        let (chunk, slot) = place::<L>(j);
        let k = slot + lane;
        (
            std::array::from_fn(|index| self.next_coordinates[chunk].0[index][k]),
            std::array::from_fn(|index| self.next_rates[chunk].0[index][k]),
            std::array::from_fn(|index| self.next_lengths[chunk].0[index][k].sqrt()),
        )
    }

    /// Sets the state of one lane; call [`Integrator::refresh`] after the last.
    pub(crate) fn set_state(
        &mut self,
        lane: usize,
        coordinates: &[[f64; COORDINATES]],
        rates: &[[f64; COORDINATES]],
    ) {
        self.trigonometry_known = false;
        for (j, (q, u)) in coordinates.iter().zip(rates).enumerate() {
            let (chunk, slot) = place::<L>(j);
            for index in 0..COORDINATES {
                self.coordinates[chunk].0[index][slot + lane] = q[index];
                self.rates[chunk].0[index][slot + lane] = u[index];
            }
        }
    }

    /// Computes the spring lengths of the present state.
    #[inline(always)]
    fn refresh(&mut self, (): ()) {
        for c in 0..self.coordinates.len() {
            spring_lengths::<L>(
                &self.body,
                &self.coordinates,
                &self.rates,
                c,
                &mut self.workspace,
                &mut self.lengths[c],
            );
        }
        self.trigonometry_known = true;
    }

    /// Accelerations of the present state, one block a chunk.
    #[inline(always)]
    fn evaluate(&mut self, motion: &BaseRows<L>) -> Vec<Block> {
        let frame = BaseFrame::new(motion, &self.gravity, &self.carries);
        let Self { body, coordinates, rates, muscles, workspace, .. } = self;
        let chunks = coordinates.len();
        let mut travel = MotionTravel::from_base(&frame);
        for first in (0..chunks).step_by(STRETCH) {
            let stretch = first..chunks.min(first + STRETCH);
            outward::<L>(body, &mut travel, coordinates, rates, stretch, false, workspace);
        }
        inward::<L>(body, coordinates, rates, muscles, workspace);
        let mut travel = InertiaTravel::BASE;
        let mut result = vec![Block::ZERO; chunks];
        for (c, out) in result.iter_mut().enumerate() {
            accelerations::<L>(body, &coordinates[c], c, &mut travel, workspace, out);
        }
        result
    }

    /// One Runge–Kutta step; `motions` is the bases at its start, middle and end. The new state goes
    /// to the `next_` fields; returns which lanes of it lie in the domain.
    #[inline(always)]
    fn advance(&mut self, motions: &[BaseRows<L>; 3]) -> [bool; L] {
        // Not a closure in `map`: it would not be compiled for this instruction set.
        let frames = [
            BaseFrame::new(&motions[0], &self.gravity, &self.carries),
            BaseFrame::new(&motions[1], &self.gravity, &self.carries),
            BaseFrame::new(&motions[2], &self.gravity, &self.carries),
        ];
        let Self { body, muscles, coordinates, rates, workspace, shares, .. } = self;
        let (stage_q, stage_u) = (&mut self.stage_coordinates, &mut self.stage_rates);
        let (next_q, next_u) = (&mut self.next_coordinates, &mut self.next_rates);
        let chunks = coordinates.len();
        let next_lengths = &mut self.next_lengths;
        // Said once, so that no index need be checked below.
        assert!(rates.len() == chunks && body.rest.len() == chunks && workspace.len() == chunks);
        assert!(stage_q.len() == chunks && stage_u.len() == chunks);
        assert!(next_q.len() == chunks && next_u.len() == chunks && next_lengths.len() == chunks);
        let mut outside = Lengths::ZERO;
        let outside = &mut outside.0[0];
        let mut a = Block::ZERO;
        // The accelerations of a stage and the first part of the next both go from base to tip: a
        // stretch of chunks at a time, one after the other, so that each fills the waits of the other.
        // (And one loop for all stages, so that the code fits the instruction cache.)
        for stage in 0..=4_usize {
            let frame = &frames[stage.div_ceil(2).min(2)];
            let mut before = InertiaTravel::BASE;
            let mut travel = MotionTravel::from_base(frame);
            for first in (0..chunks).step_by(STRETCH) {
                let stretch = first..chunks.min(first + STRETCH);
                for c in stretch.clone() {
                    if stage == 0 {
                        break;
                    }
                    let (q, u) = (&coordinates[c], &rates[c]);
                    let shape = if stage == 1 { q } else { &stage_q[c] };
                    accelerations::<L>(body, shape, c, &mut before, workspace, &mut a);
                    let next = (&mut next_q[c], &mut next_u[c]);
                    let reached = (&mut stage_q[c], &mut stage_u[c]);
                    match stage {
                        1 => first_stage(shares, (q, u), &a, next, reached),
                        2 => middle_stage(shares, &shares.half, (q, u), &a, next, reached),
                        3 => middle_stage(shares, &shares.full, (q, u), &a, next, reached),
                        _ => {
                            last_stage(shares, &stage_u[c], &a, &mut next_q[c], &mut next_u[c]);
                            let lengths = &mut next_lengths[c];
                            spring_lengths::<L>(body, next_q, next_u, c, workspace, lengths);
                            mark_outside(
                                &self.bounds,
                                &next_q[c],
                                &next_u[c],
                                &body.rest[c].radius,
                                lengths,
                                outside,
                            );
                        }
                    }
                }
                if stage < 4 {
                    let known = stage == 0 && self.trigonometry_known;
                    let (q, u) =
                        if stage == 0 { (&*coordinates, &*rates) } else { (&*stage_q, &*stage_u) };
                    outward::<L>(body, &mut travel, q, u, stretch, known, workspace);
                }
            }
            if stage < 4 {
                let (q, u) =
                    if stage == 0 { (&*coordinates, &*rates) } else { (&*stage_q, &*stage_u) };
                inward::<L>(body, q, u, muscles, workspace);
            }
        }
        // They are the next state's now.
        self.trigonometry_known = false;
        let mut inside = [true; L];
        for (slot, outside) in outside.iter().enumerate() {
            inside[slot % L] &= *outside == 0.0;
        }
        inside
    }

    /// Makes the state that the last step headed for the present one in the given lanes; the others
    /// keep theirs.
    pub(crate) fn accept_lanes(&mut self, lanes: &[bool; L]) {
        if lanes.iter().all(|lane| *lane) {
            return self.accept();
        }
        let blocks = |next: &[Block], present: &mut [Block]| {
            for (next, present) in next.iter().zip(present) {
                for (next, present) in next.0.iter().zip(&mut present.0) {
                    merge(lanes, next, present);
                }
            }
        };
        blocks(&self.next_coordinates, &mut self.coordinates);
        blocks(&self.next_rates, &mut self.rates);
        for (next, present) in self.next_lengths.iter().zip(&mut self.lengths) {
            for (next, present) in next.0.iter().zip(&mut present.0) {
                merge(lanes, next, present);
            }
        }
    }

    /// Makes the state that the last step headed for the present one, in every lane.
    pub(crate) fn accept(&mut self) {
        std::mem::swap(&mut self.coordinates, &mut self.next_coordinates);
        std::mem::swap(&mut self.rates, &mut self.next_rates);
        std::mem::swap(&mut self.lengths, &mut self.next_lengths);
        self.trigonometry_known = true;
    }
}

compiled_for_each_set! {
    /// One Runge–Kutta step; `motions` is the bases at its start, middle and end. The new state waits
    /// for [`Integrator::accept`]; returns which lanes of it lie in the domain.
    pub(crate) fn advance[L](integrator: &mut Integrator<L>, motions: &[BaseRows<L>; 3]) -> [bool; L] {
        integrator.advance(motions)
    }
}

compiled_for_each_set! {
    /// Computes the spring lengths of the present state.
    pub(crate) fn refresh[L](integrator: &mut Integrator<L>, nothing: ()) -> () {
        integrator.refresh(nothing)
    }
}

compiled_for_each_set! {
    /// Accelerations of the present state, one block a chunk.
    fn evaluate[L](integrator: &mut Integrator<L>, motion: &BaseRows<L>) -> Vec<Block> {
        integrator.evaluate(motion)
    }
}

impl Integrator<1> {
    /// Accelerations of the present state, in the order of the state's entries.
    pub(crate) fn accelerations(
        &mut self,
        instructions: Supported,
        motion: &BaseMotion,
    ) -> Vec<[f64; COORDINATES]> {
        let blocks = evaluate(instructions, self, &motion.into());
        (0..self.body.compartments)
            .map(|j| {
                let (chunk, slot) = place::<1>(j);
                std::array::from_fn(|index| blocks[chunk].0[index][slot])
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::BaseDrive;
    use crate::{Actuator, ArmParameters};

    #[test]
    fn what_lies_beyond_the_tip_stays_at_rest() {
        // Twenty compartments leave four of the third chunk's slots empty. Were they to drift, every
        // step would look as if it left the domain, and be checked twice.
        let parameters = ArmParameters::default();
        let drive = BaseDrive::new(&[(&parameters, Actuator::Servo)]);
        let mut integrator = Integrator::<1>::new(&[&parameters]);
        let (before, rates) = (integrator.coordinates[2], integrator.rates[2]);
        let mut base = [[0.0]; 4];
        for step in 0..500 {
            let angle = 0.3 * (0.02 * f64::from(step)).sin();
            let motion = drive.motion(&base, &[[angle], [0.5 * angle]]);
            base = motion[2].state();
            assert!(advance(Supported::detected(), &mut integrator, &motion) == [true]);
            integrator.accept();
        }
        for k in 4..WIDTH {
            for row in 0..COORDINATES {
                assert_eq!(integrator.coordinates[2].0[row][k], before.0[row][k]);
                assert_eq!(integrator.rates[2].0[row][k], rates.0[row][k]);
            }
        }
        assert_ne!(integrator.coordinates[2].0[1][3], before.0[1][3]);
    }
}
