//! Allowed intervals of numbers.

use std::fmt;

use crate::error::ParameterError;

/// An interval of real numbers that includes its upper end; no NaN lies in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interval {
    low: f64,
    high: f64,
    low_excluded: bool,
    unit: &'static str,
}

impl Interval {
    /// The interval \[low, high\].
    #[must_use]
    pub const fn closed(low: f64, high: f64) -> Self {
        Self { low, high, low_excluded: false, unit: "" }
    }

    /// The interval (low, high\].
    #[must_use]
    pub const fn above(low: f64, high: f64) -> Self {
        Self { low, high, low_excluded: true, unit: "" }
    }

    /// The interval \[−limit, limit\].
    #[must_use]
    pub const fn within(limit: f64) -> Self {
        Self::closed(-limit, limit)
    }

    /// The same interval, whose unit is named in messages.
    #[must_use]
    pub const fn of(self, unit: &'static str) -> Self {
        Self { unit, ..self }
    }

    /// Whether the interval includes a value.
    #[must_use]
    pub fn contains(&self, value: f64) -> bool {
        (if self.low_excluded { value > self.low } else { value >= self.low }) && value <= self.high
    }

    /// Refuses a value outside; `name` is asked only then.
    ///
    /// # Errors
    /// [`ParameterError::OutOfRange`].
    pub fn check(&self, value: f64, name: impl FnOnce() -> String) -> Result<(), ParameterError> {
        if self.contains(value) {
            return Ok(());
        }
        Err(ParameterError::out_of_range(name(), value, self))
    }
}

impl fmt::Display for Interval {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { low, high, low_excluded, unit } = self;
        let bracket = if *low_excluded { '(' } else { '[' };
        let space = if unit.is_empty() { "" } else { " " };
        write!(formatter, "{bracket}{low}, {high}]{space}{unit}")
    }
}
