//! Tables as plain data, their form on a terminal, and the settling table.

use crate::settling::{Config, SettlingExperiment};

/// What stands where a value does not exist.
pub const MISSING: &str = "–";

/// Longest line of a caption on a terminal (characters); a longer word stays whole.
pub const CAPTION_WIDTH: usize = 80;

/// A table of text. The first `text_columns` columns are text (aligned left), the others are numbers (aligned right).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Table {
    /// Says what the table shows and under which conditions.
    pub caption: String,
    /// Column titles, units included.
    pub header: Vec<String>,
    /// Cells by row; a short row is filled with empty cells, cells beyond the header are not shown.
    pub rows: Vec<Vec<String>>,
    /// Number of leading columns that hold text.
    pub text_columns: usize,
}

impl Table {
    /// A table without rows, whose first column is text.
    pub fn new(caption: impl Into<String>, header: &[&str]) -> Self {
        let header = header.iter().map(|&title| title.to_owned()).collect();
        Self { caption: caption.into(), header, rows: Vec::new(), text_columns: 1 }
    }

    /// Appends a row.
    pub fn row<S: Into<String>>(mut self, cells: impl IntoIterator<Item = S>) -> Self {
        self.rows.push(cells.into_iter().map(Into::into).collect());
        self
    }

    /// The same table under another caption: where its conditions stand elsewhere.
    #[must_use]
    pub fn under(self, caption: impl Into<String>) -> Self {
        Self { caption: caption.into(), ..self }
    }

    /// Cell of a row, empty where the row is short.
    pub fn cell<'a>(&'a self, row: &'a [String], column: usize) -> &'a str {
        row.get(column).map_or("", String::as_str)
    }

    /// The table for a terminal: the caption in lines of at most [`CAPTION_WIDTH`] characters, then aligned columns.
    ///
    /// Widths count characters, which is right for Latin and Greek letters and the signs used here.
    pub fn to_text(&self) -> String {
        let chars = |text: &str| text.chars().count();
        let widths: Vec<usize> = (0..self.header.len())
            .map(|c| {
                let cells = self.rows.iter().map(|row| chars(self.cell(row, c)));
                cells.chain([chars(&self.header[c])]).max().unwrap_or(0)
            })
            .collect();
        let line = |row: &[String]| {
            let padded = widths.iter().enumerate().map(|(c, &width)| {
                let cell = self.cell(row, c);
                if c < self.text_columns { format!("{cell:<width$}") } else { format!("{cell:>width$}") }
            });
            padded.collect::<Vec<_>>().join("   ").trim_end().to_owned() + "\n"
        };
        let rule = "─".repeat(widths.iter().sum::<usize>() + 3 * widths.len().saturating_sub(1)) + "\n";
        let body: String = self.rows.iter().map(|row| line(row)).collect();
        format!("{}{rule}{}{rule}{body}{rule}", wrap(&self.caption, CAPTION_WIDTH), line(&self.header))
    }
}

/// Breaks text between words into lines of at most `width` characters, each ended by a line end.
fn wrap(text: &str, width: usize) -> String {
    let mut lines = vec![String::new()];
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if line.is_empty() => line.push_str(word),
            Some(line) if line.chars().count() + 1 + word.chars().count() <= width => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines.join("\n") + "\n"
}

/// What a settling experiment was run on; part of the caption of everything that shows its numbers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Conditions {
    /// Where it ran, for example `simulated (virtual STM32H743)`.
    pub origin: String,
    /// The move, for example `5 mm at 1 m/s²`.
    pub step: String,
    /// The tuning, for example `100 Hz / 45°, no feedforward`.
    pub tuning: String,
    /// The plant, for example `Maxwell-slip friction, 1.8 kg`.
    pub plant: String,
}

impl Conditions {
    /// One line: `simulated … · step … · tuning … · plant … · N moves per configuration`.
    pub fn caption(&self, moves: usize) -> String {
        let moves = if moves == 1 { "1 move".to_owned() } else { format!("{moves} moves") };
        let Self { origin, step, tuning, plant } = self;
        format!("{origin} · step {step} · tuning {tuning} · plant {plant} · {moves} per configuration")
    }
}

/// The settling table: a row per tolerance, a column per configuration with mean ± standard deviation, the reduction,
/// and the unsettled moves of each configuration in their order.
pub fn settling_table(experiment: &SettlingExperiment, conditions: &Conditions) -> Table {
    let compared = experiment.configs.len() >= 2;
    let mut header = vec!["tolerance".to_owned()];
    header.extend(experiment.configs.iter().map(|config| config.name.clone()));
    if compared {
        header.push("reduction".to_owned());
    }
    header.push("unsettled".to_owned());

    let row = |t: usize, tolerance_nm: u32| {
        let mut row = vec![format!("±{tolerance_nm} nm")];
        row.extend(experiment.configs.iter().map(|config| mean_and_std(config, t)));
        if compared {
            let reduction = experiment.reduction_percent.get(t).copied().flatten();
            row.push(reduction.map_or(MISSING.to_owned(), |r| format!("{} %", number(r, 1))));
        }
        let unsettled = experiment.configs.iter().map(|c| c.unsettled.get(t).copied().unwrap_or(0).to_string());
        row.push(unsettled.collect::<Vec<_>>().join(" / "));
        row
    };
    Table {
        caption: format!(
            "Settling time after the end of the profile in ms, mean ± standard deviation: {}",
            conditions.caption(experiment.moves)
        ),
        header,
        rows: experiment.tolerances_nm.iter().enumerate().map(|(t, &tol)| row(t, tol)).collect(),
        text_columns: 1,
    }
}

/// `mean ± std` at a tolerance index (ms, one decimal); the mean alone if only one move settled.
fn mean_and_std(config: &Config, tolerance: usize) -> String {
    let at = |values: &[Option<f64>]| values.get(tolerance).copied().flatten();
    match (at(&config.mean_ms), at(&config.std_ms)) {
        (Some(mean), Some(std)) => format!("{} ± {}", number(mean, 1), number(std, 1)),
        (Some(mean), None) => number(mean, 1),
        (None, _) => MISSING.to_owned(),
    }
}

/// A number with fixed decimals and a typographic minus; a negative that rounds to zero loses its sign. What is no number is [`MISSING`].
pub fn number(value: f64, decimals: usize) -> String {
    if !value.is_finite() {
        return MISSING.to_owned();
    }
    let text = format!("{:.decimals$}", value.abs());
    let is_zero = text.chars().all(|c| matches!(c, '0' | '.'));
    if value < 0.0 && !is_zero { format!("−{text}") } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn conditions() -> Conditions {
        Conditions {
            origin: "simulated".into(),
            step: "5 mm at 1 m/s²".into(),
            tuning: "100 Hz / 45°".into(),
            plant: "Maxwell-slip, 1.8 kg".into(),
        }
    }

    fn experiment() -> SettlingExperiment {
        let tolerances_nm = [3, 100];
        let pid = [vec![None, Some(98.0)], vec![None, Some(104.0)]];
        let niasa = [vec![Some(70.0), Some(20.0)], vec![Some(90.0), Some(30.0)]];
        SettlingExperiment::new(
            &tolerances_nm,
            vec![
                Config::new("pid", &tolerances_nm, &pid, None),
                Config::new("pid+niasa", &tolerances_nm, &niasa, None),
            ],
        )
    }

    #[test]
    fn the_settling_table_reads_well_on_a_terminal() {
        let expected = "\
Settling time after the end of the profile in ms, mean ± standard deviation:
simulated · step 5 mm at 1 m/s² · tuning 100 Hz / 45° · plant Maxwell-slip, 1.8
kg · 2 moves per configuration
─────────────────────────────────────────────────────────────
tolerance           pid     pid+niasa   reduction   unsettled
─────────────────────────────────────────────────────────────
±3 nm                 –   80.0 ± 14.1           –       2 / 0
±100 nm     101.0 ± 4.2    25.0 ± 7.1      75.2 %       0 / 0
─────────────────────────────────────────────────────────────
";
        assert_eq!(settling_table(&experiment(), &conditions()).to_text(), expected);
    }

    #[test]
    fn one_configuration_has_no_reduction() {
        let mut single = experiment();
        single.configs.truncate(1);
        assert_eq!(settling_table(&single, &conditions()).header, ["tolerance", "pid", "unsettled"]);
    }

    #[test]
    fn the_caption_always_names_all_conditions() {
        assert_eq!(
            conditions().caption(1),
            "simulated · step 5 mm at 1 m/s² · tuning 100 Hz / 45° · plant Maxwell-slip, 1.8 kg · 1 move per configuration"
        );
    }

    #[test]
    fn numbers_have_a_minus_but_no_negative_zero() {
        assert_eq!(number(-33.333, 1), "−33.3");
        assert_eq!(number(-0.04, 1), "0.0");
        assert_eq!(number(0.0, 0), "0");
        assert_eq!(number(f64::NAN, 1), MISSING);
    }
}
