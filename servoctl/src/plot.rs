//! Plots as small inline SVG: lines, dots, error bars, heat maps and tolerance bands on linear, logarithmic or named axes.
//!
//! A [`Plot`] is plain data; [`Plot::svg`] draws it 480 units wide, to be scaled by the page. Colours and type come
//! from [`STYLE`], once per page, through classes and custom properties: a plot therefore follows dark mode and print.
//! Long series are thinned to what can be seen, so a trace of 16 000 samples takes a few kB.
//!
//! Why not a plotting crate: of the two looked at, `plotters` 0.3.7 pulls values beyond the axis onto its border, which
//! draws lines that are not in the data, and rounds to whole pixels; `kuva` 0.6.0 draws better, but at a fixed size (no
//! view box), and names its clip paths by a counter of the process, so that the same plot gives other bytes the second
//! time. Neither thins a series: 7 and 15 kB per line of 800 samples.

mod heat;
mod path;
mod svg;
mod ticks;

/// Width of every plot (SVG user units; one unit is about one CSS pixel on a page).
pub const WIDTH: f64 = 480.0;

/// Number of colours before they repeat.
pub const COLOURS: usize = 8;

/// Number of colours of a heat map below and above zero.
pub const HEAT_BELOW: usize = 4;
/// See [`HEAT_BELOW`].
pub const HEAT_ABOVE: usize = 8;

/// Style sheet that plots need: the palette as custom properties (light, dark and print) and the classes of the marks.
pub const STYLE: &str = include_str!("plot/style.css");

/// One pair of axes with what is drawn on it.
#[derive(Debug, Clone, PartialEq)]
pub struct Plot {
    /// What the plot shows, for readers who cannot see it.
    pub description: String,
    /// Horizontal axis.
    pub x: Axis,
    /// Vertical axis.
    pub y: Axis,
    /// Drawn in order, the last on top.
    pub series: Vec<Series>,
    /// Drawn below all series.
    pub bands: Vec<Band>,
    /// Height of the whole plot (user units).
    pub height: f64,
}

impl Plot {
    /// An empty plot.
    pub fn new(description: impl Into<String>, x: Axis, y: Axis) -> Self {
        Self { description: description.into(), x, y, series: Vec::new(), bands: Vec::new(), height: 320.0 }
    }

    /// Adds a series on top of the others.
    pub fn series(mut self, series: Series) -> Self {
        self.series.push(series);
        self
    }

    /// Adds a band.
    pub fn band(mut self, band: Band) -> Self {
        self.bands.push(band);
        self
    }

    /// The plot as an `<svg>` element for a page that carries [`STYLE`].
    pub fn svg(&self) -> String {
        svg::draw(self, "")
    }

    /// The plot as an SVG file of its own: the same element with its style sheet and size inside.
    pub fn svg_file(&self) -> String {
        svg::draw(self, STYLE)
    }
}

/// An axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Axis {
    /// Title with unit, for example `position error / nm`.
    pub title: String,
    /// How values map to positions.
    pub scale: Scale,
    /// Shown range (low, high). `None`, or a range that is empty, not finite or, on a logarithmic axis, not positive:
    /// taken from the data. What lies outside is clipped.
    pub range: Option<(f64, f64)>,
}

impl Axis {
    /// A linear axis.
    pub fn linear(title: impl Into<String>) -> Self {
        Self { title: title.into(), scale: Scale::Linear, range: None }
    }

    /// A logarithmic axis; values that are not positive interrupt a line.
    pub fn log(title: impl Into<String>) -> Self {
        Self { title: title.into(), scale: Scale::Log, range: None }
    }

    /// An axis of named places at 0, 1, 2, …
    pub fn names(title: impl Into<String>, names: impl IntoIterator<Item = String>) -> Self {
        let names: Vec<String> = names.into_iter().collect();
        let range = Some((-0.5, names.len() as f64 - 0.5));
        Self { title: title.into(), scale: Scale::Names(names), range }
    }

    /// Sets the shown range.
    pub fn range(mut self, low: f64, high: f64) -> Self {
        self.range = Some((low, high));
        self
    }
}

/// How an axis maps values to positions.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Scale {
    /// Evenly.
    Linear,
    /// By the logarithm, with decades marked.
    Log,
    /// Evenly, with names instead of numbers at 0, 1, 2, …
    Names(Vec<String>),
}

/// What is drawn in one colour and stands in the legend under one name.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// Legend entry; an empty name has none.
    pub name: String,
    /// Index of the colour, taken modulo [`COLOURS`].
    pub colour: usize,
    /// Drawn in order.
    pub marks: Vec<Mark>,
}

impl Series {
    /// An empty series.
    pub fn new(name: impl Into<String>, colour: usize) -> Self {
        Self { name: name.into(), colour, marks: Vec::new() }
    }

    /// Adds a thin line through (x, y) points.
    pub fn line(mut self, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        self.marks.push(Mark::Line(points.into_iter().collect()));
        self
    }

    /// Adds faint dots at (x, y), for single results behind their mean.
    pub fn dots(mut self, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        self.marks.push(Mark::Dots(points.into_iter().collect()));
        self
    }

    /// Adds a strong dot at (x, y) with a bar from y − `error` to y + `error`.
    pub fn error_bar(mut self, x: f64, y: f64, error: f64) -> Self {
        self.marks.push(Mark::ErrorBar { x, y, error });
        self
    }

    /// Adds a heat map; its colour bar stands above the frame, under the name of the series.
    pub fn heat(mut self, heat: Heat) -> Self {
        self.marks.push(Mark::Heat(heat));
        self
    }
}

/// One thing drawn. Points that are not finite interrupt a line and are otherwise left out.
#[derive(Debug, Clone, PartialEq)]
pub enum Mark {
    /// A thin line through points in their order; x need not increase.
    Line(Vec<(f64, f64)>),
    /// Faint dots.
    Dots(Vec<(f64, f64)>),
    /// A dot with a symmetric vertical bar.
    ErrorBar {
        /// Horizontal place.
        x: f64,
        /// Centre.
        y: f64,
        /// Half length of the bar.
        error: f64,
    },
    /// Cells coloured by their values.
    Heat(Heat),
}

impl Mark {
    /// All (x, y) that a range taken from the data must contain.
    fn extent(&self) -> Vec<(f64, f64)> {
        match self {
            Mark::Line(points) | Mark::Dots(points) => points.clone(),
            &Mark::ErrorBar { x, y, error } => vec![(x, y - error), (x, y + error)],
            Mark::Heat(heat) => vec![(heat.x.0, heat.y.0), (heat.x.1, heat.y.1)],
        }
    }
}

/// A grid of equal cells, each coloured by the class its value falls into: blue below zero, yellow to brown above.
#[derive(Debug, Clone, PartialEq)]
pub struct Heat {
    /// Left and right edge of the grid.
    pub x: (f64, f64),
    /// Lower and upper edge of the grid.
    pub y: (f64, f64),
    /// Number of columns.
    pub columns: usize,
    /// Values row by row, from the lowest row up; an incomplete last row is not drawn.
    pub values: Vec<f64>,
    /// Edges of the classes, increasing; at best up to [`HEAT_BELOW`] classes below zero and [`HEAT_ABOVE`] above.
    pub levels: Vec<f64>,
    /// Legend entry of values that are not finite; an empty name has none.
    pub missing: String,
}

/// A shaded region across the whole plot: a tolerance, a window. With `from` equal to `to`, a dashed line.
#[derive(Debug, Clone, PartialEq)]
pub struct Band {
    /// Legend entry; an empty name has none.
    pub name: String,
    /// Axis whose values `from` and `to` are.
    pub on: Direction,
    /// One edge.
    pub from: f64,
    /// The other edge.
    pub to: f64,
}

impl Band {
    /// A horizontal band of y values.
    pub fn y(name: impl Into<String>, from: f64, to: f64) -> Self {
        Self { name: name.into(), on: Direction::Y, from, to }
    }

    /// A vertical band of x values.
    pub fn x(name: impl Into<String>, from: f64, to: f64) -> Self {
        Self { name: name.into(), on: Direction::X, from, to }
    }
}

/// One of the two axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    /// Horizontal axis.
    X,
    /// Vertical axis.
    Y,
}

#[cfg(test)]
mod tests;
