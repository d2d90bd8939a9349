//! The fourth-order Runge–Kutta step over chunks, and the choice of instruction set.

use std::sync::OnceLock;

use crate::base::BaseMotion;
use crate::domain::{Bounds, chunk_is_inside};
use crate::kernel::{
    BaseFrame, Block, Body, Material, Muscles, Rest, Row, WIDTH, Workspace, evaluate, place,
    spring_lengths,
};
use crate::parameters::ArmParameters;
use crate::state::COORDINATES;
use crate::transcendental::sin_cos;

/// State and scratch memory of `L` arms of one shape.
#[derive(Clone, Debug)]
pub(crate) struct Engine<const L: usize> {
    body: Body,
    bounds: Bounds,
    base_radius: [f64; L],
    gravity: [f64; 3],
    timestep: f64,
    pub(crate) muscles: Vec<Muscles>,
    coordinates: Vec<Block>,
    rates: Vec<Block>,
    lengths: Vec<[Row; 4]>,
    /// The state that a step is heading for; becomes the state if it lies in the domain.
    next_coordinates: Vec<Block>,
    next_rates: Vec<Block>,
    next_lengths: Vec<[Row; 4]>,
    stage_coordinates: Vec<Block>,
    stage_rates: Vec<Block>,
    workspace: Workspace,
}

/// Vector instructions that a step may be compiled for. The bits are the same for all of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum InstructionSet {
    /// What every processor of the architecture has. Without fused multiply-add in hardware this is
    /// slow: the bits come first.
    Baseline,
    /// AVX2 and FMA.
    Avx2,
    /// AVX-512 (F, DQ, VL, BW) and FMA.
    Avx512,
}

impl InstructionSet {
    /// The best set of this processor, or the one that the environment variable
    /// `OCTOARM_INSTRUCTION_SET` (`baseline`, `avx2`, `avx512`) names, if the processor has it.
    #[must_use]
    pub fn detected() -> Self {
        static DETECTED: OnceLock<InstructionSet> = OnceLock::new();
        *DETECTED.get_or_init(|| {
            let best = Self::best();
            match std::env::var("OCTOARM_INSTRUCTION_SET").as_deref() {
                Ok("baseline") => Self::Baseline,
                Ok("avx2") if best != Self::Baseline => Self::Avx2,
                _ => best,
            }
        })
    }

    /// The best set of this processor.
    #[must_use]
    #[cfg(target_arch = "x86_64")]
    pub fn best() -> Self {
        let avx2 = is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma");
        let avx512 = is_x86_feature_detected!("avx512f")
            && is_x86_feature_detected!("avx512dq")
            && is_x86_feature_detected!("avx512vl")
            && is_x86_feature_detected!("avx512bw");
        match (avx2, avx512) {
            (true, true) => Self::Avx512,
            (true, false) => Self::Avx2,
            _ => Self::Baseline,
        }
    }

    /// The best set of this processor.
    #[must_use]
    #[cfg(not(target_arch = "x86_64"))]
    pub fn best() -> Self {
        Self::Baseline
    }
}

/// `out = factor x + y`.
#[inline(always)]
fn axpy(factor: f64, x: &Block, y: &Block, out: &mut Block) {
    for row in 0..COORDINATES {
        for k in 0..WIDTH {
            out.0[row][k] = factor.mul_add(x.0[row][k], y.0[row][k]);
        }
    }
}

/// `out += factor x`.
#[inline(always)]
fn accumulate(factor: f64, x: &Block, out: &mut Block) {
    for row in 0..COORDINATES {
        for k in 0..WIDTH {
            out.0[row][k] = factor.mul_add(x.0[row][k], out.0[row][k]);
        }
    }
}

impl<const L: usize> Engine<L> {
    pub(crate) fn new(parameters: &ArmParameters) -> Self {
        let n = parameters.compartments;
        let chunks = (n * L).div_ceil(WIDTH);
        let mut rest = vec![
            Rest {
                radius: [parameters.tip_radius; WIDTH],
                volume: [parameters.rest_volume(n - 1); WIDTH]
            };
            chunks
        ];
        let mut at_rest = Block::ZERO;
        at_rest.0[0] = [parameters.rest_height(); WIDTH];
        for row in &mut at_rest.0[3..] {
            *row = [parameters.tip_radius; WIDTH];
        }
        for j in 0..n {
            let (chunk, slot) = place::<L>(j);
            rest[chunk].radius[slot..slot + L].fill(parameters.rest_radius(j + 1));
            rest[chunk].volume[slot..slot + L].fill(parameters.rest_volume(j));
        }
        let workspace = Workspace::new(chunks);
        let mut engine = Self {
            body: Body { compartments: n, material: Box::new(Material::new(parameters)), rest },
            bounds: Bounds::new(parameters),
            base_radius: [parameters.base_radius; L],
            gravity: parameters.gravity,
            timestep: parameters.timestep,
            muscles: vec![Muscles::ZERO; chunks],
            coordinates: vec![at_rest; chunks],
            rates: vec![Block::ZERO; chunks],
            lengths: vec![[[0.0; WIDTH]; 4]; chunks],
            next_coordinates: vec![at_rest; chunks],
            next_rates: vec![Block::ZERO; chunks],
            next_lengths: vec![[[0.0; WIDTH]; 4]; chunks],
            stage_coordinates: vec![at_rest; chunks],
            stage_rates: vec![Block::ZERO; chunks],
            workspace,
        };
        engine.refresh_lengths();
        engine
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
        self.lengths[chunk][i][slot + lane]
    }

    /// What [`Engine::coordinate`], [`Engine::rate`] and [`Engine::length`] would be after the step
    /// that [`Engine::advance`] has just refused.
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
            std::array::from_fn(|index| self.next_lengths[chunk][index][k]),
        )
    }

    /// Sets the state of one lane; call [`Engine::refresh_lengths`] after the last.
    pub(crate) fn set_state(
        &mut self,
        lane: usize,
        coordinates: &[[f64; COORDINATES]],
        rates: &[[f64; COORDINATES]],
    ) {
        for (j, (q, u)) in coordinates.iter().zip(rates).enumerate() {
            let (chunk, slot) = place::<L>(j);
            for index in 0..COORDINATES {
                self.coordinates[chunk].0[index][slot + lane] = q[index];
                self.rates[chunk].0[index][slot + lane] = u[index];
            }
        }
    }

    pub(crate) fn refresh_lengths(&mut self) {
        spring_lengths::<L>(
            &self.body,
            &self.base_radius,
            &self.coordinates,
            &self.rates,
            &mut self.workspace,
            &mut self.lengths,
        );
    }

    /// The base's motion as its own frame sees it.
    #[inline(always)]
    fn base_frame(&self, motions: &[BaseMotion; L]) -> BaseFrame<L> {
        let mut frame = BaseFrame {
            omega: [[0.0; L]; 3],
            psi: [[0.0; L]; 3],
            gravity: [[0.0; L]; 3],
            radius: self.base_radius,
        };
        for (lane, motion) in motions.iter().enumerate() {
            let (sine_theta, cosine_theta) = sin_cos(motion.angle[0]);
            let (s, c) = sin_cos(motion.angle[1]);
            let [theta_rate, phi_rate] = motion.rate;
            let [theta_acceleration, phi_acceleration] = motion.acceleration;
            // R_0 = R_x(θ) R_y(φ): ω = θ̇ R_yᵀ x + φ̇ y.
            frame.omega[0][lane] = c * theta_rate;
            frame.omega[1][lane] = phi_rate;
            frame.omega[2][lane] = s * theta_rate;
            frame.psi[0][lane] = c.mul_add(theta_acceleration, -(s * theta_rate * phi_rate));
            frame.psi[1][lane] = phi_acceleration;
            frame.psi[2][lane] = s.mul_add(theta_acceleration, c * theta_rate * phi_rate);
            let [x, y, z] = self.gravity;
            let (y, z) = (
                cosine_theta.mul_add(y, sine_theta * z),
                cosine_theta.mul_add(z, -(sine_theta * y)),
            );
            frame.gravity[0][lane] = c.mul_add(x, -(s * z));
            frame.gravity[1][lane] = y;
            frame.gravity[2][lane] = c.mul_add(z, s * x);
        }
        frame
    }

    /// Evaluates the present state's accelerations into the workspace.
    #[inline(always)]
    fn evaluate_inline(&mut self, motions: &[BaseMotion; L]) {
        let frame = self.base_frame(motions);
        evaluate::<L>(
            &self.body,
            &frame,
            &self.coordinates,
            &self.rates,
            &self.muscles,
            &mut self.workspace,
        );
    }

    /// One Runge–Kutta step; `motions` is the base at its start, middle and end. Returns whether the
    /// new state lies in the domain; if not, the state is as it was before.
    #[inline(always)]
    fn advance_inline(&mut self, motions: &[[BaseMotion; L]; 3]) -> bool {
        let [start, middle, end] = [
            self.base_frame(&motions[0]),
            self.base_frame(&motions[1]),
            self.base_frame(&motions[2]),
        ];
        let chunks = self.body.rest.len();
        let dt = self.timestep;
        let (half, sixth, third) = (0.5 * dt, dt / 6.0, dt / 3.0);
        let Self { body, muscles, coordinates, rates, workspace, .. } = self;
        let (stage_q, stage_u) = (&mut self.stage_coordinates, &mut self.stage_rates);
        let (next_q, next_u) = (&mut self.next_coordinates, &mut self.next_rates);

        evaluate::<L>(body, &start, coordinates, rates, muscles, workspace);
        for c in 0..chunks {
            let (q, u, a) = (&coordinates[c], &rates[c], &workspace.accelerations[c]);
            axpy(sixth, u, q, &mut next_q[c]);
            axpy(sixth, a, u, &mut next_u[c]);
            axpy(half, u, q, &mut stage_q[c]);
            axpy(half, a, u, &mut stage_u[c]);
        }
        for (frame, advance) in [(&middle, half), (&middle, dt)] {
            evaluate::<L>(body, frame, stage_q, stage_u, muscles, workspace);
            for c in 0..chunks {
                let (q, u, a) = (&coordinates[c], &rates[c], &workspace.accelerations[c]);
                accumulate(third, &stage_u[c], &mut next_q[c]);
                accumulate(third, a, &mut next_u[c]);
                axpy(advance, &stage_u[c], q, &mut stage_q[c]);
                axpy(advance, a, u, &mut stage_u[c]);
            }
        }
        evaluate::<L>(body, &end, stage_q, stage_u, muscles, workspace);
        for c in 0..chunks {
            accumulate(sixth, &stage_u[c], &mut next_q[c]);
            accumulate(sixth, &workspace.accelerations[c], &mut next_u[c]);
        }

        spring_lengths::<L>(
            body,
            &self.base_radius,
            next_q,
            next_u,
            workspace,
            &mut self.next_lengths,
        );
        let mut inside = true;
        for c in 0..chunks {
            inside &= chunk_is_inside(
                &self.bounds,
                &next_q[c],
                &next_u[c],
                &body.rest[c].radius,
                &self.next_lengths[c],
            );
        }
        if inside {
            self.accept();
        }
        inside
    }

    /// Makes the state that the last step headed for the present one.
    pub(crate) fn accept(&mut self) {
        std::mem::swap(&mut self.coordinates, &mut self.next_coordinates);
        std::mem::swap(&mut self.rates, &mut self.next_rates);
        std::mem::swap(&mut self.lengths, &mut self.next_lengths);
    }
}

/// The functions of this module that run in the instruction set of the caller's choice.
macro_rules! dispatched {
    ($($(#[$documentation:meta])* $name:ident => $inline:ident($motions:ty) -> $result:ty;)*) => {
        $(
            impl Engine<1> {
                $(#[$documentation])*
                #[allow(unsafe_code)]
                pub(crate) fn $name(
                    &mut self,
                    instructions: InstructionSet,
                    motions: &$motions,
                ) -> $result {
                    #[cfg(target_arch = "x86_64")]
                    #[target_feature(enable = "avx2,fma,avx512f,avx512dq,avx512vl,avx512bw")]
                    fn avx512(engine: &mut Engine<1>, motions: &$motions) -> $result {
                        engine.$inline(motions)
                    }
                    #[cfg(target_arch = "x86_64")]
                    #[target_feature(enable = "avx2,fma")]
                    fn avx2(engine: &mut Engine<1>, motions: &$motions) -> $result {
                        engine.$inline(motions)
                    }
                    match instructions {
                        // SAFETY: `InstructionSet` yields these only where the processor has the
                        // features that the two functions are compiled for.
                        #[cfg(target_arch = "x86_64")]
                        InstructionSet::Avx512 => unsafe { avx512(self, motions) },
                        // SAFETY: as above.
                        #[cfg(target_arch = "x86_64")]
                        InstructionSet::Avx2 => unsafe { avx2(self, motions) },
                        _ => self.$inline(motions),
                    }
                }
            }
        )*
    };
}

dispatched! {
    /// One Runge–Kutta step; `motions` is the base at its start, middle and end. Returns whether the
    /// new state lies in the domain; if not, the state is as it was before.
    advance => advance_inline([[BaseMotion; 1]; 3]) -> bool;
    /// Evaluates the present state's accelerations into the workspace.
    evaluate => evaluate_inline([BaseMotion; 1]) -> ();
}

impl Engine<1> {
    /// Accelerations of the present state, in the order of the state's entries.
    pub(crate) fn accelerations(
        &mut self,
        instructions: InstructionSet,
        motion: &BaseMotion,
    ) -> Vec<[f64; COORDINATES]> {
        self.evaluate(instructions, &[*motion]);
        (0..self.body.compartments)
            .map(|j| {
                let (chunk, slot) = place::<1>(j);
                std::array::from_fn(|index| self.workspace.accelerations[chunk].0[index][slot])
            })
            .collect()
    }
}
