//! Draws a plot: lay out the frame, map values to places, write the elements from back to front.

use super::heat::BAR_HEIGHT;
use super::path::{Point, Rect, path};
use super::ticks::{Tick, ticks};
use super::{Axis, Band, COLOURS, Direction, Heat, Mark, Plot, Scale, Series, WIDTH};
use crate::typeset::{Piece, pieces};
use std::fmt::Write;

/// Sizes (user units); `GLYPH` is the width of an average character of the 13-unit type, on the wide side.
const GLYPH: f64 = 7.4;
const LINE_HEIGHT: f64 = 18.0;
const LEFT_LEAST: f64 = 58.0;
const BOTTOM: f64 = 46.0;
const KEY: f64 = 22.0;

/// The whole element. `style` is put inside, together with a size, for a file of its own.
pub fn draw(plot: &Plot, style: &str) -> String {
    let legend = Legend::of(plot);
    let (low_y, high_y) = range(&plot.y, Direction::Y, plot);
    let (low_x, high_x) = range(&plot.x, Direction::X, plot);
    let bar_top = 6.0 + legend.rows as f64 * LINE_HEIGHT;
    let top = 4.0 + bar_top + if heat(plot).is_some() { BAR_HEIGHT } else { 0.0 };
    let y_ticks = ticks(&plot.y.scale, low_y, high_y, ((plot.height - top - BOTTOM) / 45.0) as usize);
    let longest = y_ticks.iter().filter_map(|t| t.label.as_ref()).map(|l| l.chars().count()).max().unwrap_or(0);
    let left = (28.0 + longest as f64 * GLYPH).max(LEFT_LEAST);
    let x_ticks = ticks(&plot.x.scale, low_x, high_x, 6);
    let last_x = x_ticks.iter().rev().find_map(|t| t.label.as_ref()).map_or(0, |l| l.chars().count());
    let right = WIDTH - (3.0 + last_x as f64 * GLYPH / 2.0).clamp(8.0, 40.0);
    let frame = Rect { left, top, right, bottom: (plot.height - BOTTOM).max(top + 40.0) };
    let x = Mapping::new(&plot.x.scale, (low_x, high_x), (frame.left, frame.right));
    let y = Mapping::new(&plot.y.scale, (low_y, high_y), (frame.bottom, frame.top));

    let mut out = String::new();
    let (width, height) = (n(WIDTH), n(plot.height));
    let size = if style.is_empty() { String::new() } else { format!(r#" width="{width}" height="{height}""#) };
    let style = if style.is_empty() { String::new() } else { format!("<style>{}</style>", escape(style)) };
    put(
        &mut out,
        format_args!(
            r#"<svg xmlns="http://www.w3.org/2000/svg" class="plot" viewBox="0 0 {width} {height}"{size} role="img" aria-label="{}">{style}"#,
            escape(&plot.description)
        ),
    );
    if !style.is_empty() {
        // A file of its own stands on a page of any colour.
        out.push_str(&rect("paper", 0.0, 0.0, WIDTH, plot.height));
    }
    for band in &plot.bands {
        draw_band(&mut out, band, frame, &x, &y);
    }
    draw_axes(&mut out, plot, frame, (&x, &x_ticks), (&y, &y_ticks));
    for series in &plot.series {
        draw_series(&mut out, series, frame, &x, &y);
    }
    legend.draw(&mut out, frame.left);
    if let Some(heat) = heat(plot) {
        heat.draw_bar(&mut out, frame.left, frame.right, bar_top);
    }
    out.push_str("</svg>");
    out
}

/// The heat map whose colour bar is drawn.
fn heat(plot: &Plot) -> Option<&Heat> {
    plot.series.iter().flat_map(|s| &s.marks).find_map(|m| if let Mark::Heat(heat) = m { Some(heat) } else { None })
}

/// Values of one axis to places on the drawing.
pub struct Mapping {
    log: bool,
    low: f64,
    place: f64,
    per_unit: f64,
}

impl Mapping {
    fn new(scale: &Scale, (low, high): (f64, f64), (start, end): (f64, f64)) -> Self {
        let log = *scale == Scale::Log;
        let (low, high) = if log { (low.log10(), high.log10()) } else { (low, high) };
        Self { log, low, place: start, per_unit: (end - start) / (high - low) }
    }

    /// Place of a value; `None` if it is not finite or has no logarithm.
    pub fn at(&self, value: f64) -> Option<f64> {
        let value = if self.log { (value > 0.0).then(|| value.log10())? } else { value };
        value.is_finite().then_some(self.place + (value - self.low) * self.per_unit)
    }
}

/// The axis' own range if it is usable, else that of the data with a margin, else 0 to 1 (1 to 10 if logarithmic).
fn range(axis: &Axis, direction: Direction, plot: &Plot) -> (f64, f64) {
    let log = axis.scale == Scale::Log;
    let usable = |&(low, high): &(f64, f64)| low.is_finite() && high.is_finite() && low < high && (!log || low > 0.0);
    if let Some(range) = axis.range.filter(usable) {
        return range;
    }
    let values = plot.series.iter().flat_map(|s| &s.marks).flat_map(Mark::extent);
    let values = values.map(|(x, y)| if direction == Direction::X { x } else { y });
    let values = values.filter(|v| v.is_finite() && (!log || *v > 0.0)).map(|v| if log { v.log10() } else { v });
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
    if low > high {
        return if log { (1.0, 10.0) } else { (0.0, 1.0) };
    }
    let margin = match (high - low, direction) {
        (0.0, _) if log => 0.5,
        (0.0, _) => low.abs().max(1.0) * 0.5,
        (span, Direction::X) => span * 0.01,
        (span, Direction::Y) => span * 0.05,
    };
    let (low, high) = (low - margin, high + margin);
    if log { (10f64.powf(low), 10f64.powf(high)) } else { (low, high) }
}

fn draw_band(out: &mut String, band: &Band, frame: Rect, x: &Mapping, y: &Mapping) {
    let mapping = if band.on == Direction::X { x } else { y };
    let (Some(from), Some(to)) = (mapping.at(band.from), mapping.at(band.to)) else { return };
    let (first, last) = match band.on {
        Direction::X => (frame.left, frame.right),
        Direction::Y => (frame.top, frame.bottom),
    };
    let (from, to) = (from.min(to), from.max(to));
    if to < first || from > last {
        return;
    }
    let (from, to) = (from.max(first), to.min(last));
    let length = to - from;
    let shape = match (band.on, from == to) {
        (Direction::X, true) => vertical_line("rule", from, frame),
        (Direction::Y, true) => horizontal_line("rule", from, frame),
        (Direction::X, false) => rect("band", from, frame.top, length, frame.bottom - frame.top),
        (Direction::Y, false) => rect("band", frame.left, from, frame.right - frame.left, length),
    };
    out.push_str(&shape);
}

fn draw_axes(out: &mut String, plot: &Plot, frame: Rect, x: (&Mapping, &[Tick]), y: (&Mapping, &[Tick])) {
    let has_vertical_grid = !matches!(plot.x.scale, Scale::Names(_));
    for (tick, place) in x.1.iter().filter_map(|t| Some((t, x.0.at(t.value)?))) {
        let class = if tick.label.is_some() { "grid" } else { "fine" };
        if has_vertical_grid {
            out.push_str(&vertical_line(class, place, frame));
        }
        if let Some(label) = &tick.label {
            text(out, "tick", (place, frame.bottom + 17.0), "middle", label);
        }
    }
    for (tick, place) in y.1.iter().filter_map(|t| Some((t, y.0.at(t.value)?))) {
        let class = if tick.label.is_some() { "grid" } else { "fine" };
        out.push_str(&horizontal_line(class, place, frame));
        if let Some(label) = &tick.label {
            text(out, "tick", (frame.left - 7.0, place + 4.5), "end", label);
        }
    }
    out.push_str(&rect("frame", frame.left, frame.top, frame.right - frame.left, frame.bottom - frame.top));
    text(out, "", ((frame.left + frame.right) / 2.0, plot.height - 8.0), "middle", &plot.x.title);
    let middle = n((frame.top + frame.bottom) / 2.0);
    let title = set(&plot.y.title);
    put(
        out,
        format_args!(r#"<text transform="translate(13 {middle})rotate(-90)" text-anchor="middle">{title}</text>"#),
    );
}

fn draw_series(out: &mut String, series: &Series, frame: Rect, x: &Mapping, y: &Mapping) {
    let place = |&(px, py): &(f64, f64)| -> Option<Point> { Some((x.at(px)?, y.at(py)?)) };
    let inside = |p: &Point| p.0 >= frame.left && p.0 <= frame.right && p.1 >= frame.top && p.1 <= frame.bottom;
    let mut lines = String::new();
    let mut shapes = String::new();
    for mark in &series.marks {
        match mark {
            Mark::Line(points) => {
                let d = path(&points.iter().map(place).collect::<Vec<_>>(), frame);
                if !d.is_empty() {
                    put(&mut lines, format_args!(r#"<path d="{d}"/>"#));
                }
            }
            Mark::Heat(heat) => heat.draw(out, frame, x, y),
            Mark::Dots(points) => {
                for p in points.iter().filter_map(place).filter(inside) {
                    put(
                        &mut shapes,
                        format_args!(r#"<circle class="faint" cx="{}" cy="{}" r="2.6"/>"#, n(p.0), n(p.1)),
                    );
                }
            }
            Mark::ErrorBar { x: at, y: value, error } => {
                let ends = [place(&(*at, value - error)), place(&(*at, value + error))];
                if let [Some(low), Some(high)] = ends {
                    let [from, to] = [low.1, high.1].map(|y| y.clamp(frame.top, frame.bottom));
                    if from != to && inside(&(low.0, from)) {
                        put(
                            &mut shapes,
                            format_args!(r#"<path class="bar" d="M{} {}V{}"/>"#, n(low.0), n(from), n(to)),
                        );
                    }
                }
                if let Some(p) = place(&(*at, *value)).filter(inside) {
                    put(&mut shapes, format_args!(r#"<circle cx="{}" cy="{}" r="4"/>"#, n(p.0), n(p.1)));
                }
            }
        }
    }
    let colour = series.colour % COLOURS;
    if !lines.is_empty() {
        put(out, format_args!(r#"<g class="k{colour}" transform="scale(.1)"><g class="lines">{lines}</g></g>"#));
    }
    if !shapes.is_empty() {
        put(out, format_args!(r#"<g class="k{colour}">{shapes}</g>"#));
    }
}

/// Entries above the frame, in rows.
struct Legend<'a> {
    rows: usize,
    /// Row, offset from the left edge of the frame, key, name.
    entries: Vec<(usize, f64, Key, &'a str)>,
}

/// What stands before a name in the legend.
enum Key {
    Line(usize),
    /// A line through points with their error bars.
    DottedLine(usize),
    Dot(usize),
    Band,
    Rule,
    /// Nothing: the colour bar below belongs to the name.
    Title,
    /// What a heat map has no value for.
    Missing,
}

impl<'a> Legend<'a> {
    fn of(plot: &'a Plot) -> Self {
        let key = |s: &Series| {
            let colour = s.colour % COLOURS;
            let has = |mark: fn(&Mark) -> bool| s.marks.iter().any(mark);
            match (has(|m| matches!(m, Mark::Line(_))), has(|m| matches!(m, Mark::ErrorBar { .. }))) {
                (true, false) => Key::Line(colour),
                (true, true) => Key::DottedLine(colour),
                (false, _) => Key::Dot(colour),
            }
        };
        let series = plot.series.iter().flat_map(|s| match s.marks.first() {
            Some(Mark::Heat(heat)) => vec![(Key::Title, s.name.as_str()), (Key::Missing, heat.missing.as_str())],
            _ => vec![(key(s), s.name.as_str())],
        });
        let bands = plot.bands.iter().map(|b| (if b.from == b.to { Key::Rule } else { Key::Band }, b.name.as_str()));
        let mut legend = Self { rows: 0, entries: Vec::new() };
        let mut offset = 0.0;
        for (key, name) in series.chain(bands).filter(|(_, name)| !name.is_empty()) {
            let key_width = if matches!(key, Key::Title) { 0.0 } else { KEY + 6.0 };
            let width = key_width + name.chars().count() as f64 * GLYPH + 14.0;
            if legend.rows == 0 || offset + width > WIDTH - LEFT_LEAST {
                legend.rows += 1;
                offset = 0.0;
            }
            legend.entries.push((legend.rows - 1, offset, key, name));
            offset += width;
        }
        legend
    }

    fn draw(&self, out: &mut String, left: f64) {
        for (row, offset, key, name) in &self.entries {
            let (from, middle) = (left + offset, 11.0 + *row as f64 * LINE_HEIGHT);
            let (start, end, centre) = (n(from), n(from + KEY), n(from + KEY / 2.0));
            let y = n(middle);
            let line = |colour: &usize| format!(r#"<path class="key k{colour}" d="M{start} {y}H{end}"/>"#);
            let dot = |colour: &usize| format!(r#"<circle class="k{colour}" cx="{centre}" cy="{y}" r="4"/>"#);
            out.push_str(&match key {
                Key::Line(colour) => line(colour),
                Key::Dot(colour) => dot(colour),
                Key::DottedLine(colour) => line(colour) + &dot(colour),
                Key::Band => rect("band", from, middle - 6.0, KEY, 12.0),
                Key::Rule => format!(r#"<path class="rule" d="M{start} {y}H{end}"/>"#),
                Key::Missing => rect("heat none", from, middle - 6.0, KEY, 12.0),
                Key::Title => String::new(),
            });
            let name_from = if matches!(key, Key::Title) { from } else { from + KEY + 6.0 };
            text(out, "", (name_from, middle + 4.5), "start", name);
        }
    }
}

fn vertical_line(class: &str, x: f64, frame: Rect) -> String {
    format!(r#"<path class="{class}" d="M{} {}V{}"/>"#, n(x), n(frame.top), n(frame.bottom))
}

fn horizontal_line(class: &str, y: f64, frame: Rect) -> String {
    format!(r#"<path class="{class}" d="M{} {}H{}"/>"#, n(frame.left), n(y), n(frame.right))
}

fn rect(class: &str, x: f64, y: f64, width: f64, height: f64) -> String {
    let (x, y, width, height) = (n(x), n(y), n(width), n(height));
    format!(r#"<rect class="{class}" x="{x}" y="{y}" width="{width}" height="{height}"/>"#)
}

pub fn text(out: &mut String, class: &str, (x, y): Point, anchor: &str, content: &str) {
    let class = if class.is_empty() { String::new() } else { format!(r#" class="{class}""#) };
    let anchor = if anchor == "start" { String::new() } else { format!(r#" text-anchor="{anchor}""#) };
    put(out, format_args!(r#"<text{class} x="{}" y="{}"{anchor}>{}</text>"#, n(x), n(y), set(content)));
}

/// A text with its symbols set: what is not on the line is small, and lower or higher.
fn set(content: &str) -> String {
    const INDEX: i32 = 3;
    const EXPONENT: i32 = -5;
    let mut height = 0;
    let part = |piece| {
        let (text, at) = match piece {
            Piece::Text(text) => (text, 0),
            Piece::Index(text) => (text, INDEX),
            Piece::Exponent(text) => (text, EXPONENT),
        };
        let step = at - height;
        height = at;
        let size = if at == 0 { "" } else { r#" font-size="75%""# };
        if step == 0 { escape(text) } else { format!(r#"<tspan dy="{step}"{size}>{}</tspan>"#, escape(text)) }
    };
    pieces(content).into_iter().map(part).collect()
}

/// A coordinate with at most one decimal.
pub fn n(value: f64) -> String {
    let rounded = (value * 10.0).round() / 10.0 + 0.0;
    rounded.to_string()
}

/// Appends formatted text; writing to a string cannot fail.
pub fn put(out: &mut String, content: std::fmt::Arguments) {
    let _ = out.write_fmt(content);
}

/// Text for XML content and attributes; characters that XML does not allow become a replacement sign.
pub fn escape(content: &str) -> String {
    let mut out = String::with_capacity(content.len());
    for c in content.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\u{0}'..='\u{8}' | '\u{b}' | '\u{c}' | '\u{e}'..='\u{1f}' | '\u{fffe}' | '\u{ffff}' => {
                out.push('\u{fffd}')
            }
            c => out.push(c),
        }
    }
    out
}
