//! Draws a heat map: one path per class of values, and the colour bar that explains them.

use super::path::Rect;
use super::svg::{Mapping, n, put, text};
use super::{HEAT_ABOVE, HEAT_BELOW, Heat};

/// Height of the colour bar with its numbers (user units).
pub const BAR_HEIGHT: f64 = 34.0;

impl Heat {
    /// Class of the style sheet for a value: `b0`, `b1`, … downwards from zero, `a0`, `a1`, … upwards, `none` for what
    /// is not finite. The outermost colours serve all values beyond them.
    fn class(&self, value: f64) -> String {
        if !value.is_finite() {
            return "none".into();
        }
        self.class_between(self.levels.iter().filter(|&&level| level <= value).count())
    }

    /// Class for what lies above `below` of the levels.
    fn class_between(&self, below: usize) -> String {
        let zero = self.levels.iter().filter(|&&level| level <= 0.0).count();
        match below.checked_sub(zero) {
            Some(up) => format!("a{}", up.min(HEAT_ABOVE - 1)),
            None => format!("b{}", (zero - 1 - below).min(HEAT_BELOW - 1)),
        }
    }

    /// Appends the cells, neighbours of one class in a row joined, clipped to the frame.
    pub(super) fn draw(&self, out: &mut String, frame: Rect, x: &Mapping, y: &Mapping) {
        let rows = self.values.len() / self.columns.max(1);
        let edge = |(low, high): (f64, f64), i: usize, count: usize| low + (high - low) * i as f64 / count as f64;
        let place_x = |i| x.at(edge(self.x, i, self.columns)).map(|p| p.clamp(frame.left, frame.right));
        let place_y = |i| y.at(edge(self.y, i, rows)).map(|p| p.clamp(frame.top, frame.bottom));
        let mut paths: Vec<(String, String)> = Vec::new();
        for (row, values) in self.values.chunks_exact(self.columns.max(1)).enumerate() {
            let mut column = 0;
            for run in values.chunk_by(|&a, &b| self.class(a) == self.class(b)) {
                let (first, last) = (column, column + run.len());
                column = last;
                let (Some(left), Some(right)) = (place_x(first), place_x(last)) else { continue };
                let (Some(bottom), Some(top)) = (place_y(row), place_y(row + 1)) else { continue };
                let class = self.class(run[0]);
                let index = paths.iter().position(|(c, _)| *c == class).unwrap_or_else(|| {
                    paths.push((class, String::new()));
                    paths.len() - 1
                });
                let (left, right, top, bottom) = (n(left), n(right), n(top), n(bottom));
                put(&mut paths[index].1, format_args!("M{left} {top}H{right}V{bottom}H{left}z"));
            }
        }
        paths.sort();
        for (class, d) in &paths {
            put(out, format_args!(r#"<path class="heat {class}" d="{d}"/>"#));
        }
    }

    /// Appends the colour bar between `left` and `right`, its upper edge at `top`.
    pub(super) fn draw_bar(&self, out: &mut String, left: f64, right: f64, top: f64) {
        let width = (right - left) / (self.levels.len() + 1) as f64;
        for class in 0..=self.levels.len() {
            let (from, to) = (n(left + class as f64 * width), n(left + (class + 1) as f64 * width));
            let (name, bottom) = (self.class_between(class), n(top + 10.0));
            put(out, format_args!(r#"<path class="heat {name}" d="M{from} {}H{to}V{bottom}H{from}z"/>"#, n(top)));
        }
        for (i, &level) in self.levels.iter().enumerate() {
            let decimals = if level == level.round() { 0 } else { 1 };
            let place = (left + (i + 1) as f64 * width, top + 24.0);
            text(out, "tick", place, "middle", &crate::table::number(level, decimals));
        }
    }
}
