//! Where the tip of an arm that reaches is to be brought.

use std::sync::LazyLock;

use octoarm_arm::{Interval, ParameterError};

/// Largest coordinate of a goal \[m\].
pub(crate) const FARTHEST: f64 = 10.0;
/// NumPy's file of rows (x, y, z), which `octoarm reach goals` writes.
const FILE: &[u8] = include_bytes!("goals.npy");
/// Bytes of its begin; the length of the header is told by the two after the first eight.
const BEGIN: usize = 10;

/// Where the tip of the default body has been held by its muscles, (x, y, z) \[m\]: held activations, drawn
/// at random, five seconds from rest; thinned to one point in every cube of 12 mm.
#[must_use]
pub fn reachable_goals() -> &'static [[f64; 3]] {
    static GOALS: LazyLock<Vec<[f64; 3]>> = LazyLock::new(|| {
        let header = usize::from(u16::from_le_bytes([FILE[8], FILE[9]]));
        let (numbers, _) = FILE[BEGIN + header..].as_chunks::<8>();
        let numbers: Vec<f64> = numbers.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect();
        numbers.as_chunks().0.to_vec()
    });
    &GOALS
}

/// Checks a goal \[m\], whose coordinates have these names.
pub(crate) fn check_goal(
    goal: [f64; 3],
    name: impl Fn(usize) -> String,
) -> Result<(), ParameterError> {
    let mut axes = goal.into_iter().enumerate();
    axes.try_for_each(|(axis, value)| {
        Interval::within(FARTHEST).of("m").check(value, || name(axis))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_file_is_read_to_its_end() {
        let goals = reachable_goals();
        assert_eq!(goals.len(), 1611);
        assert!(FILE.starts_with(b"\x93NUMPY\x01\x00") && FILE.len() == 128 + 24 * goals.len());
        for (index, goal) in goals.iter().enumerate() {
            check_goal(*goal, |axis| format!("goals[{index}, {axis}]")).expect("a goal");
            assert!((0.05..0.6).contains(&crate::reach_config::distance(*goal, [0.0; 3])));
        }
    }
}
