//! The rest state: where the springs carry the arm's weight in water.

use nalgebra::{DMatrix, DVector};

use crate::base::BaseMotion;
use crate::error::ParameterError;
use crate::instruction_set::Supported;
use crate::interrupt::poll;
use crate::parameters::ArmParameters;
use crate::runge_kutta::Integrator;
use crate::state::{ArmState, COORDINATES};

/// Newton steps for one gravity load.
const ITERATIONS: usize = 40;
/// Largest acceleration that counts as rest \[m/s², rad/s²\].
const AT_REST: f64 = 1e-6;
/// Largest acceleration at which the search ends: rounding of the forces on a joint.
const EXACT: f64 = 1e-11;

/// Accelerations at rest in the given shape, as one vector.
fn residual(
    integrator: &mut Integrator<1>,
    instructions: Supported,
    shape: &DVector<f64>,
    still: &[[f64; COORDINATES]],
) -> DVector<f64> {
    let coordinates: Vec<[f64; COORDINATES]> =
        (0..still.len()).map(|j| std::array::from_fn(|k| shape[j * COORDINATES + k])).collect();
    integrator.set_state(0, &coordinates, still);
    let accelerations = integrator.accelerations(instructions, &BaseMotion::default());
    DVector::from_iterator(shape.len(), accelerations.into_iter().flatten())
}

fn solve(
    integrator: &mut Integrator<1>,
    instructions: Supported,
    mut shape: DVector<f64>,
    still: &[[f64; COORDINATES]],
) -> Result<(DVector<f64>, f64), ParameterError> {
    let size = shape.len();
    let mut left = residual(integrator, instructions, &shape, still);
    for _ in 0..ITERATIONS {
        let before = left.amax();
        if before <= EXACT {
            break;
        }
        let mut jacobian = DMatrix::zeros(size, size);
        for column in 0..size {
            poll()?;
            let width = 1e-7;
            let mut moved = shape.clone();
            moved[column] += width;
            let plus = residual(integrator, instructions, &moved, still);
            moved[column] -= 2.0 * width;
            let minus = residual(integrator, instructions, &moved, still);
            jacobian.set_column(column, &((plus - minus) / (2.0 * width)));
        }
        let Some(step) = jacobian.lu().solve(&left) else { break };
        // Backtracking keeps a large load from throwing the shape out of the domain.
        let mut fraction = 1.0;
        let mut improved = false;
        while fraction > 1e-4 {
            let trial = &shape - &step * fraction;
            let trial_left = residual(integrator, instructions, &trial, still);
            if trial_left.amax() < before {
                shape = trial;
                left = trial_left;
                improved = true;
                break;
            }
            fraction *= 0.5;
        }
        if !improved {
            break;
        }
    }
    let size_left = left.amax();
    Ok((shape, size_left))
}

/// Static equilibrium at θ = φ = 0, without muscle inputs: Newton's method on the accelerations, in
/// growing shares of gravity if the full load does not converge from the undeformed shape.
///
/// # Errors
/// [`ParameterError::NoEquilibrium`] if no shape at rest is found; one that is may lie outside the
/// domain, and need not be stable. [`ParameterError::Interrupted`].
pub(crate) fn static_equilibrium(
    parameters: &ArmParameters,
    instructions: Supported,
) -> Result<ArmState, ParameterError> {
    let undeformed = ArmState::undeformed(parameters);
    let start = DVector::from_iterator(
        undeformed.coordinates.len() * COORDINATES,
        undeformed.coordinates.iter().flatten().copied(),
    );
    let mut worst = f64::INFINITY;
    for shares in [1_u32, 10, 100] {
        let mut shape = start.clone();
        for share in 1..=shares {
            let fraction = f64::from(share) / f64::from(shares);
            let loaded = ArmParameters {
                gravity: parameters.gravity.map(|g| g * fraction),
                ..parameters.clone()
            };
            (shape, worst) =
                solve(&mut Integrator::new(&[&loaded]), instructions, shape, &undeformed.rates)?;
            if worst > AT_REST || worst.is_nan() {
                break;
            }
        }
        if worst <= AT_REST {
            let coordinates = (0..parameters.compartments)
                .map(|j| std::array::from_fn(|k| shape[j * COORDINATES + k]))
                .collect();
            return Ok(ArmState { coordinates, ..undeformed });
        }
    }
    Err(ParameterError::NoEquilibrium {
        reason: format!("accelerations up to {worst:.3e} SI units remain"),
    })
}
