//! How quantities are kept: rows of slots, and where a compartment's slot is.

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
    pub(crate) fn radii(&self) -> &[Row; 4] {
        let [_, _, _, radii @ ..] = &self.0;
        radii
    }
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

/// Where compartment `j` of a body with `L` lanes lives: chunk, and slot of its first lane.
#[inline(always)]
pub(crate) const fn place<const L: usize>(compartment: usize) -> (usize, usize) {
    let flat = compartment * L;
    (flat / WIDTH, flat % WIDTH)
}

/// Moves every slot of `this` outward by one compartment; the first `L` slots come from `before`.
#[inline(always)]
pub(crate) fn shift_outward<const L: usize>(before: &Row, this: &Row, out: &mut Row) {
    for k in 0..WIDTH {
        out[k] = if k < L { before[WIDTH - L + k] } else { this[k - L] };
    }
}
