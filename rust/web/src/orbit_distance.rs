//! How far a point is from a closed curve.

/// The distance of a point from a closed chain of points.
pub(crate) fn distance(curve: &[[f64; 2]], point: [f64; 2]) -> f64 {
    let ends = curve.iter().skip(1).chain(curve.first());
    let squares = curve.iter().zip(ends).map(|(from, to)| {
        let along = [to[0] - from[0], to[1] - from[1]];
        let way = [point[0] - from[0], point[1] - from[1]];
        let length = (along[0] * along[0] + along[1] * along[1]).max(f64::MIN_POSITIVE);
        let share = ((way[0] * along[0] + way[1] * along[1]) / length).clamp(0.0, 1.0);
        let (x, y) = (way[0] - share * along[0], way[1] - share * along[1]);
        x * x + y * y
    });
    squares.fold(f64::INFINITY, f64::min).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_point_may_lie_between_two() {
        let square = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
        assert!((distance(&square, [0.5, -0.25]) - 0.25).abs() < 1e-15);
        assert!((distance(&square, [0.1, 0.5]) - 0.1).abs() < 1e-15);
        assert!((distance(&square, [2.0, 2.0]) - 2.0_f64.sqrt()).abs() < 1e-15);
    }
}
