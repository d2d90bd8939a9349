//! The arm's step as a linear map of small deviations.

use nalgebra::DMatrix;

use crate::arm::Arm;
use crate::arm_lanes::ArmLanes;
use crate::domain::DomainError;
use crate::parameters::ArmParameters;
use crate::state::{ArmState, COORDINATES};

const WIDTH: usize = ArmLanes::WIDTH;

/// Half of the displacement of a central difference, in units of [`scales`]: rounding is still small,
/// and it hardly ever takes a strut across the jumps of the water's lift, which would pass for steep
/// slopes.
const DISPLACEMENT: f64 = 1e-7;

/// A step of an arm, linearised about a state and a command.
///
/// With n compartments a state is a vector of 14 n + 4 numbers: the coordinates
/// `[h, α, β, r1..r4]` of every compartment \[m, rad, rad, m…\], then their rates, then the base
/// `[θ, φ, θ̇, φ̇]` \[rad, rad/s\].
#[derive(Clone, Debug, PartialEq)]
pub struct Linearisation {
    /// Jacobian (14 n + 4, 14 n + 4) of the next state with respect to the state.
    pub state: DMatrix<f64>,
    /// Jacobian (14 n + 4, 2) of the next state with respect to the command \[per degree\].
    pub command: DMatrix<f64>,
    /// Jacobian (4 n, 14 n + 4) of the spring lengths \[m\] before the step with respect to the state.
    pub lengths: DMatrix<f64>,
}

/// Natural size of each number of a state: a rest length, a radian, a base radius, and a turn of the
/// cycles a second.
fn scales(parameters: &ArmParameters) -> Vec<f64> {
    let (length, radius) = (parameters.rest_length, parameters.base_radius);
    let row = [length, 1.0, 1.0, radius, radius, radius, radius];
    let coordinates = row.repeat(parameters.compartments);
    let rates = coordinates.iter().map(|scale| 15.0 * scale);
    coordinates.iter().copied().chain(rates).chain([0.5, 0.5, 8.0, 8.0]).collect()
}

/// The number of a state at a place of its vector.
fn entry(state: &mut ArmState, index: usize) -> &mut f64 {
    let size = state.coordinates.len() * COORDINATES;
    if index < size {
        &mut state.coordinates.as_flattened_mut()[index]
    } else if index < 2 * size {
        &mut state.rates.as_flattened_mut()[index - size]
    } else {
        &mut state.base[index - 2 * size]
    }
}

impl Arm {
    /// The Jacobians of one step from the present state under a command θ, φ \[degrees\], with respect
    /// to state and command, by central differences in lanes. The arm does not move, muscle inputs are
    /// kept.
    ///
    /// What the matrices make of a deviation is right to 1e-8 of its largest entry (tests/linearise.rs
    /// measures 3e-9). Where the water's flow past a strut turns over, its force jumps: there the
    /// derivative is that of one side.
    ///
    /// # Errors
    /// [`DomainError`] if the step would leave the domain; a command that is not finite counts as that
    /// too.
    pub fn linearise(&self, command: [f64; 2]) -> Result<Linearisation, DomainError> {
        let present = self.state();
        let scales = scales(self.parameters());
        let (size, springs) = (scales.len(), self.observation_len());
        let mut lanes = ArmLanes::new(&[self; WIDTH]).expect("eight arms of one body");
        let mut jacobian = DMatrix::zeros(size, size + 2);
        let mut lengths = DMatrix::zeros(springs, size);
        let mut before = vec![vec![0.0; springs]; WIDTH];
        // Two lanes a column: a little ahead, and as much behind.
        let columns: Vec<usize> = (0..size + 2).collect();
        for columns in columns.chunks(WIDTH / 2) {
            let mut states: [ArmState; WIDTH] = std::array::from_fn(|_| present.clone());
            let mut commands = [command; WIDTH];
            let mut widths = [0.0; WIDTH / 2];
            for (pair, &column) in columns.iter().enumerate() {
                let [ahead, behind] = [2 * pair, 2 * pair + 1].map(|lane| {
                    let number = match column.checked_sub(size) {
                        None => entry(&mut states[lane], column),
                        Some(axis) => &mut commands[lane][axis],
                    };
                    let half = DISPLACEMENT * scales.get(column).unwrap_or(&10.0);
                    *number += if lane % 2 == 0 { half } else { -half };
                    *number
                });
                // What was really displaced, after rounding.
                widths[pair] = ahead - behind;
            }
            let places: Vec<(usize, &ArmState)> = states.iter().enumerate().collect();
            lanes.restore(&places);
            for (lane, row) in before.iter_mut().enumerate() {
                lanes.lengths_into(lane, row);
            }
            if !lanes.step(&commands, &[true; WIDTH])
                && let Some(failure) = (0..WIDTH).find_map(|lane| lanes.failure(lane))
            {
                return Err(failure);
            }
            for (pair, &column) in columns.iter().enumerate() {
                let mut ahead = lanes.state(2 * pair);
                let mut behind = lanes.state(2 * pair + 1);
                for row in 0..size {
                    let difference = *entry(&mut ahead, row) - *entry(&mut behind, row);
                    jacobian[(row, column)] = difference / widths[pair];
                }
                if column < size {
                    for row in 0..springs {
                        let difference = before[2 * pair][row] - before[2 * pair + 1][row];
                        lengths[(row, column)] = difference / widths[pair];
                    }
                }
            }
        }
        let command = jacobian.columns(size, 2).into_owned();
        Ok(Linearisation { state: jacobian.columns(0, size).into_owned(), command, lengths })
    }
}
