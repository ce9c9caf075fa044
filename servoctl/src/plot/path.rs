//! From many points to a short path: thin, clip, simplify, write.
//!
//! Points are in user units of the drawing, y downwards; the path is written in tenths of them as relative whole numbers.

/// A point (user units).
pub type Point = (f64, f64);

/// A rectangle (user units).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rect {
    /// Left edge.
    pub left: f64,
    /// Upper edge.
    pub top: f64,
    /// Right edge.
    pub right: f64,
    /// Lower edge.
    pub bottom: f64,
}

/// Width of the columns that a trace is thinned to, and how far a simplified line may lie beside the original.
const COLUMN: f64 = 1.0;
const TOLERANCE: f64 = 0.25;

/// The `d` attribute of a line through `points`, `None` marking an interruption; empty if nothing is visible.
pub fn path(points: &[Option<Point>], window: Rect) -> String {
    let mut d = String::new();
    for stretch in points.split(Option::is_none) {
        let stretch: Vec<Point> = stretch.iter().copied().flatten().collect();
        for run in clip(&thin(&stretch), window) {
            write(&mut d, &simplify(&run));
        }
    }
    d
}

/// First, extreme and last points of each column of width [`COLUMN`], in their order, where x never decreases;
/// all points otherwise. What can be seen stays: the outline of noise and single outliers.
fn thin(points: &[Point]) -> Vec<Point> {
    if points.windows(2).any(|w| w[1].0 < w[0].0) {
        return points.to_vec();
    }
    let column = |p: &Point| (p.0 / COLUMN).floor();
    let mut kept = Vec::new();
    for group in points.chunk_by(|a, b| column(a) == column(b)) {
        let by_y = |&a: &usize, &b: &usize| group[a].1.total_cmp(&group[b].1);
        let highest = (0..group.len()).max_by(by_y).unwrap_or(0);
        let lowest = (0..group.len()).min_by(by_y).unwrap_or(0);
        let mut chosen = [0, highest.min(lowest), highest.max(lowest), group.len() - 1].to_vec();
        chosen.dedup();
        kept.extend(chosen.into_iter().map(|i| group[i]));
    }
    kept
}

/// The parts of a line that lie inside the window, cut exactly at its edges.
fn clip(points: &[Point], window: Rect) -> Vec<Vec<Point>> {
    let mut runs: Vec<Vec<Point>> = Vec::new();
    for pair in points.windows(2) {
        let Some((start, end)) = clip_segment(pair[0], pair[1], window) else { continue };
        match runs.last_mut() {
            Some(run) if run.last() == Some(&start) => run.push(end),
            _ => runs.push(vec![start, end]),
        }
    }
    runs
}

/// The part of a segment inside the window (Liang and Barsky), `None` if there is none.
fn clip_segment(a: Point, b: Point, window: Rect) -> Option<(Point, Point)> {
    let (dx, dy) = (b.0 - a.0, b.1 - a.1);
    let (mut enter, mut leave) = (0.0f64, 1.0f64);
    let edges =
        [(-dx, a.0 - window.left), (dx, window.right - a.0), (-dy, a.1 - window.top), (dy, window.bottom - a.1)];
    for (towards, room) in edges {
        if towards == 0.0 {
            if room < 0.0 {
                return None;
            }
        } else if towards < 0.0 {
            enter = enter.max(room / towards);
        } else {
            leave = leave.min(room / towards);
        }
    }
    let at = |t: f64| match t {
        0.0 => a,
        1.0 => b,
        t => (a.0 + t * dx, a.1 + t * dy),
    };
    (enter <= leave).then(|| (at(enter), at(leave)))
}

/// Leaves out points that lie within [`TOLERANCE`] of the line without them (Douglas and Peucker, without recursion).
fn simplify(points: &[Point]) -> Vec<Point> {
    if points.len() < 3 {
        return points.to_vec();
    }
    let mut keep = vec![false; points.len()];
    let mut spans = vec![(0, points.len() - 1)];
    while let Some((first, last)) = spans.pop() {
        keep[first] = true;
        keep[last] = true;
        let farthest = (first + 1..last)
            .map(|i| (i, distance(points[i], points[first], points[last])))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        if let Some((middle, distance)) = farthest
            && distance > TOLERANCE
        {
            spans.push((first, middle));
            spans.push((middle, last));
        }
    }
    points.iter().zip(&keep).filter_map(|(&p, &keep)| keep.then_some(p)).collect()
}

/// Distance of `p` from the segment `a`–`b`.
fn distance(p: Point, a: Point, b: Point) -> f64 {
    let (dx, dy) = (b.0 - a.0, b.1 - a.1);
    let length_squared = dx * dx + dy * dy;
    let along = if length_squared > 0.0 { ((p.0 - a.0) * dx + (p.1 - a.1) * dy) / length_squared } else { 0.0 };
    let along = along.clamp(0.0, 1.0);
    (p.0 - a.0 - along * dx).hypot(p.1 - a.1 - along * dy)
}

/// Appends `M x y l dx dy …` in tenths; steps that vanish in the rounding are left out.
fn write(d: &mut String, points: &[Point]) {
    let tenths = |p: &Point| ((p.0 * 10.0).round() as i64, (p.1 * 10.0).round() as i64);
    let mut points = points.iter().map(tenths);
    let Some(mut last) = points.next() else { return };
    d.push_str(&format!("M{} {}l", last.0, last.1));
    let mut steps = String::new();
    for point in points {
        let (dx, dy) = (point.0 - last.0, point.1 - last.1);
        if (dx, dy) != (0, 0) {
            let separator = if steps.is_empty() || dx < 0 { "" } else { " " };
            steps.push_str(&format!("{separator}{dx}{}{dy}", if dy < 0 { "" } else { " " }));
        }
        last = point;
    }
    d.push_str(if steps.is_empty() { "0 0" } else { &steps });
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const WINDOW: Rect = Rect { left: 0.0, top: 0.0, right: 100.0, bottom: 50.0 };

    fn line(points: &[Point]) -> String {
        path(&points.iter().copied().map(Some).collect::<Vec<_>>(), WINDOW)
    }

    #[test]
    fn a_straight_line_keeps_only_its_ends() {
        let points: Vec<Point> = (0..=1000).map(|i| (f64::from(i) * 0.1, 20.0)).collect();
        assert_eq!(line(&points), "M0 200l1000 0");
    }

    #[test]
    fn a_line_is_cut_where_it_leaves_the_window_and_resumed_where_it_returns() {
        // Out through the upper edge at x = 25, in again at x = 75: nothing may be drawn along the edge.
        assert_eq!(line(&[(0.0, 25.0), (50.0, -25.0), (100.0, 25.0)]), "M0 250l250-250M750 0l250 250");
        assert_eq!(line(&[(0.0, -1.0), (100.0, -1.0)]), "");
    }

    #[test]
    fn an_interruption_splits_the_path() {
        let points = [Some((0.0, 1.0)), Some((1.0, 1.0)), None, Some((5.0, 2.0)), Some((6.0, 2.0))];
        assert_eq!(path(&points, WINDOW), "M0 10l10 0M50 20l10 0");
    }

    #[test]
    fn a_single_outlier_among_many_samples_survives() {
        let points: Vec<Point> =
            (0..100_000).map(|i| (f64::from(i) * 1e-3, if i == 31_415 { 5.0 } else { 40.0 })).collect();
        let d = line(&points);
        assert!(d.contains("-350") && d.len() < 60, "{d}");
    }

    #[test]
    fn a_loop_that_runs_backwards_is_kept_as_it_is() {
        assert_eq!(line(&[(10.0, 10.0), (90.0, 40.0), (10.0, 10.5)]), "M100 100l800 300-800-295");
    }

    proptest! {
        #[test]
        fn noise_of_any_length_keeps_its_outline_and_stays_small(
            noise in prop::collection::vec(0.0..50.0f64, 2..5000)
        ) {
            let n = noise.len() as f64;
            let points: Vec<Point> = noise.iter().enumerate().map(|(i, &y)| (i as f64 / n * 100.0, y)).collect();
            let thinned = thin(&points);
            let extremes = |points: &[Point]| points.iter().fold((f64::MAX, f64::MIN), |(low, high), p| (low.min(p.1), high.max(p.1)));
            prop_assert_eq!(extremes(&points), extremes(&thinned));
            prop_assert!(line(&points).len() < 101 * 4 * 12);
        }

        #[test]
        fn a_clipped_segment_lies_in_the_window_and_on_the_segment(
            a in (-300.0..300.0f64, -300.0..300.0f64), b in (-300.0..300.0f64, -300.0..300.0f64)
        ) {
            if let Some((start, end)) = clip_segment(a, b, WINDOW) {
                for p in [start, end] {
                    prop_assert!((-1e-9..=100.0 + 1e-9).contains(&p.0) && (-1e-9..=50.0 + 1e-9).contains(&p.1));
                    prop_assert!(distance(p, a, b) < 1e-9);
                }
            } else {
                for i in 0..=1000 {
                    let t = f64::from(i) / 1000.0;
                    let p = (a.0 + t * (b.0 - a.0), a.1 + t * (b.1 - a.1));
                    prop_assert!(!((0.0..=100.0).contains(&p.0) && (0.0..=50.0).contains(&p.1)));
                }
            }
        }

        #[test]
        fn a_simplified_line_passes_within_the_tolerance_of_every_point(
            points in prop::collection::vec((0.0..100.0f64, 0.0..50.0f64), 2..200)
        ) {
            let simple = simplify(&points);
            for &p in &points {
                let nearest = simple.windows(2).map(|w| distance(p, w[0], w[1])).fold(f64::MAX, f64::min);
                prop_assert!(nearest <= TOLERANCE);
            }
        }
    }
}
