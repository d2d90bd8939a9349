//! What a teacher's run leaves behind for the readout: least squares over all steps, in little memory.

use nalgebra::DMatrix;
use octoarm_arm::{Interval, LinearReadout, ParameterError};

/// Outputs of the readout, θ and φ.
const OUTPUTS: usize = 2;
/// Rows that are gathered before they enter the triangle.
const BLOCK: usize = 256;
/// Half width of the noise that a fit allows for \[m\].
const NOISE: Interval = Interval::closed(1e-13, 1e-2);

/// Rows of spring lengths S and of the commands T that must follow them, as the triangular factor of
/// (S, T): least squares need to know no more, whatever the number of rows.
#[derive(Clone, Debug)]
pub(crate) struct Lesson {
    springs: usize,
    /// The factor, and below it the rows of the block that waits.
    matrix: DMatrix<f64>,
    waiting: usize,
    rows: usize,
}

/// The triangular factor of a matrix, square.
fn triangle(matrix: DMatrix<f64>) -> DMatrix<f64> {
    matrix.qr().unpack_r()
}

impl Lesson {
    pub(crate) fn new(springs: usize) -> Self {
        let columns = springs + OUTPUTS;
        let matrix = DMatrix::zeros(columns + BLOCK, columns);
        Self { springs, matrix, waiting: 0, rows: 0 }
    }

    /// Steps that are known.
    pub(crate) fn rows(&self) -> usize {
        self.rows
    }

    /// The command \[degrees\] that shall follow the lengths \[m\].
    pub(crate) fn record(&mut self, lengths: &[f64], command: [f64; 2]) {
        let row = self.springs + OUTPUTS + self.waiting;
        for (column, value) in lengths.iter().chain(&command).enumerate() {
            self.matrix[(row, column)] = *value;
        }
        (self.waiting, self.rows) = (self.waiting + 1, self.rows + 1);
        if self.waiting == BLOCK {
            self.absorb();
        }
    }

    fn absorb(&mut self) {
        let columns = self.springs + OUTPUTS;
        let empty = DMatrix::zeros(columns + BLOCK, columns);
        let factor = triangle(std::mem::replace(&mut self.matrix, empty));
        self.matrix.rows_mut(0, columns).copy_from(&factor);
        self.waiting = 0;
    }

    /// The readout W with the least ‖S W − T‖² + M ν²/3 ‖W‖² over the M rows: what white noise, uniform
    /// in \[−ν, ν\] metres on every length, asks for on average (section 2.2.2); and the root mean
    /// square of its error \[degrees\].
    ///
    /// # Errors
    /// [`ParameterError`] for fewer rows than springs, or noise out of range.
    pub(crate) fn fit(&mut self, noise: f64) -> Result<(LinearReadout, f64), ParameterError> {
        NOISE.of("metres").check(noise, || "noise".to_owned())?;
        if self.rows < self.springs {
            let range = format!("of at least {} steps that a teacher showed", self.springs);
            return Err(ParameterError::out_of_range("lesson", self.rows, range));
        }
        self.absorb();
        let (springs, columns) = (self.springs, self.springs + OUTPUTS);
        let mut system = DMatrix::zeros(springs + columns, columns);
        system.rows_mut(0, columns).copy_from(&self.matrix.rows(0, columns));
        let ridge = noise * (self.rows as f64 / 3.0).sqrt();
        for spring in 0..springs {
            system[(columns + spring, spring)] = ridge;
        }
        let factor = triangle(system);
        let mut weights = factor.view((0, springs), (springs, OUTPUTS)).into_owned();
        if !factor.view((0, 0), (springs, springs)).solve_upper_triangular_mut(&mut weights) {
            return Err(ParameterError::out_of_range("noise", noise, "of noise that can be told"));
        }
        let known = self.matrix.view((0, 0), (columns, springs));
        let wanted = self.matrix.view((0, springs), (columns, OUTPUTS));
        let error = (known * &weights - wanted).norm() / (self.rows as f64).sqrt();
        let rows: Vec<[f64; 2]> = weights.row_iter().map(|row| [row[0], row[1]]).collect();
        Ok((LinearReadout::from_rows(&rows, springs)?, error))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn least_squares_are_those_of_the_normal_equations() {
        let (springs, rows) = (3, 1000);
        let mut lesson = Lesson::new(springs);
        let mut all = DMatrix::zeros(rows, springs);
        let mut wanted = DMatrix::zeros(rows, OUTPUTS);
        for row in 0..rows {
            let time = row as f64 * 0.01;
            let lengths = [time.sin(), (1.7 * time).cos(), (0.3 * time).sin()];
            let command = [2.0 * lengths[0] - lengths[2], lengths[1] + 0.1 * (5.0 * time).sin()];
            lesson.record(&lengths, command);
            all.row_mut(row).copy_from_slice(&lengths);
            wanted.row_mut(row).copy_from_slice(&command);
        }
        let noise = 1e-2;
        let (readout, error) = lesson.fit(noise).expect("readout");
        let ridge = rows as f64 * noise * noise / 3.0;
        let moments = all.transpose() * &all + DMatrix::identity(springs, springs) * ridge;
        let expected =
            moments.lu().solve(&(all.transpose() * &wanted)).expect("moments of full rank");
        for (row, weights) in readout.weights.iter().enumerate() {
            for (column, weight) in weights.iter().enumerate() {
                // The moments have lost half of the digits at most.
                assert!((weight - expected[(row, column)]).abs() < 1e-10);
            }
        }
        let residual = (&all * expected - wanted).norm() / (rows as f64).sqrt();
        assert!((error - residual).abs() < 1e-12);
    }

    #[test]
    fn what_cannot_be_fitted_is_refused() {
        let mut lesson = Lesson::new(3);
        let message = lesson.fit(1e-6).expect_err("nothing known").to_string();
        assert!(message.starts_with("lesson = 0 is outside"), "{message}");
        for bad in [0.0, -1.0, f64::NAN, 1.0] {
            let message = lesson.fit(bad).expect_err("bad noise").to_string();
            assert!(message.starts_with("noise = "), "{message}");
        }
    }
}
