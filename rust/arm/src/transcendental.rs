//! Sine, cosine, arc tangent and exponential from polynomials alone.
//!
//! The platform's mathematical library is not used anywhere in the physics: its last bits change
//! from one system to the next, and its calls stop a loop from being vectorised. Coefficients and
//! schemes are fdlibm's (Sun Microsystems, 1993: `k_sin.c`, `k_cos.c`, `s_atan.c`); sine and cosine
//! are within 1 ulp on the angles the arm can reach. All functions are branch-free.

use std::f64::consts::FRAC_2_PI;

use crate::multiply_add::MultiplyAdd;

/// `π/2` in two parts: with fused multiply-adds the reduced angle is off by less than 10⁻³² a quadrant.
const HALF_PI_HIGH: f64 = f64::from_bits(0x3FF9_21FB_5444_2D18);
const HALF_PI_MIDDLE: f64 = f64::from_bits(0x3C91_A626_3314_5C07);
/// 1.5 · 2⁵²: adding it leaves the nearest integer in the low bits of the significand.
const ROUND: f64 = 6_755_399_441_055_744.0;

const SIN: [f64; 6] = [
    1.589_690_995_211_55e-10,
    -2.505_076_025_340_686_3e-8,
    2.755_731_370_707_006_8e-6,
    -1.984_126_982_985_795e-4,
    8.333_333_333_322_49e-3,
    -1.666_666_666_666_663_2e-1,
];
const COS: [f64; 6] = [
    -1.135_964_755_778_819_5e-11,
    2.087_572_321_298_175e-9,
    -2.755_731_435_139_066_3e-7,
    2.480_158_728_947_673e-5,
    -1.388_888_888_887_411e-3,
    4.166_666_666_666_66e-2,
];
const ATAN: [f64; 11] = [
    1.628_582_011_536_578_2e-2,
    -3.653_157_274_421_691_6e-2,
    4.976_877_994_615_932e-2,
    -5.833_570_133_790_573_5e-2,
    6.661_073_137_387_531e-2,
    -7.691_876_205_044_83e-2,
    9.090_887_133_436_507e-2,
    -1.111_111_040_546_235_6e-1,
    1.428_571_427_250_346_6e-1,
    -1.999_999_999_987_648_3e-1,
    3.333_333_333_333_293e-1,
];

/// Sine and cosine of an angle in radians.
#[inline(always)]
#[must_use]
pub fn sin_cos(angle: f64) -> (f64, f64) {
    let shifted = angle.madd(FRAC_2_PI, ROUND);
    let quadrant = shifted.to_bits();
    let turns = shifted - ROUND;
    let x = (-turns).madd(HALF_PI_HIGH, angle);
    let x = (-turns).madd(HALF_PI_MIDDLE, x);
    // Even and odd powers of z apart: two chains half as long.
    let z = x * x;
    let w = z * z;

    let even = SIN[1].madd(w, SIN[3]).madd(w, SIN[5]);
    let odd = SIN[0].madd(w, SIN[2]).madd(w, SIN[4]);
    let sine = (z * x).madd(odd.madd(z, even), x);

    let even = COS[1].madd(w, COS[3]).madd(w, COS[5]);
    let odd = COS[0].madd(w, COS[2]).madd(w, COS[4]);
    let half = 0.5 * z;
    let near_one = 1.0 - half;
    let cosine = near_one + w.madd(odd.madd(z, even), (1.0 - near_one) - half);

    let swap = quadrant & 1 != 0;
    let (a, b) = if swap { (cosine, sine) } else { (sine, cosine) };
    let sine_sign = (quadrant & 2) << 62;
    let cosine_sign = (quadrant.wrapping_add(1) & 2) << 62;
    (f64::from_bits(a.to_bits() ^ sine_sign), f64::from_bits(b.to_bits() ^ cosine_sign))
}

/// Arc tangent of a number in [0, 7/16], where fdlibm's polynomial needs no reduction.
#[inline(always)]
#[must_use]
pub fn atan_small(x: f64) -> f64 {
    // Even and odd powers of z apart: two chains half as long.
    let z = x * x;
    let w = z * z;
    let even = ATAN[0].madd(w, ATAN[2]);
    let even = even.madd(w, ATAN[4]);
    let even = even.madd(w, ATAN[6]);
    let even = even.madd(w, ATAN[8]);
    let even = even.madd(w, ATAN[10]);
    let odd = ATAN[1].madd(w, ATAN[3]);
    let odd = odd.madd(w, ATAN[5]);
    let odd = odd.madd(w, ATAN[7]);
    let odd = odd.madd(w, ATAN[9]);
    (-(x * z)).madd(odd.madd(z, even), x)
}

/// `exp(-x)` for `x >= 0`: Taylor's series on a halved argument, squared back.
#[must_use]
pub fn exp_negative(x: f64) -> f64 {
    if x > 800.0 {
        return 0.0;
    }
    let mut halvings = 0;
    let mut reduced = x;
    while reduced > 0.5 {
        reduced *= 0.5;
        halvings += 1;
    }
    let mut sum = 1.0;
    for term in (1..=20_u32).rev() {
        sum = 1.0 - sum * reduced / f64::from(term);
    }
    for _ in 0..halvings {
        sum *= sum;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sine_and_cosine_agree_with_the_platform() {
        for k in -40_000..40_000 {
            let angle = f64::from(k) * 1.234_567e-3;
            let (sine, cosine) = sin_cos(angle);
            // One ulp of a result of size one.
            assert!((sine - angle.sin()).abs() < 2.3e-16, "sin {angle}");
            assert!((cosine - angle.cos()).abs() < 2.3e-16, "cos {angle}");
        }
        assert_eq!(sin_cos(0.0), (0.0, 1.0));
        let (sine, cosine) = sin_cos(f64::NAN);
        assert!(sine.is_nan() && cosine.is_nan());
    }

    #[test]
    fn odd_and_even_to_the_bit() {
        for k in 0..10_000 {
            let angle = f64::from(k) * 3.7e-4;
            let (s, c) = sin_cos(angle);
            assert_eq!(sin_cos(-angle), (-s, c));
        }
    }

    #[test]
    fn arc_tangent_and_exponential_agree_with_the_platform() {
        for k in 0..=4375 {
            let x = f64::from(k) * 1e-4;
            assert!((atan_small(x) - x.atan()).abs() < 1.2e-16, "atan {x}");
        }
        for k in 0..2000 {
            let x = f64::from(k) * 0.013;
            // Squaring back up to six times doubles the relative rounding error each time.
            assert!((exp_negative(x) - (-x).exp()).abs() < 3e-14 * (-x).exp(), "exp {x}");
        }
    }
}
