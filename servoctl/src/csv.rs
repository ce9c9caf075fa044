//! Measured columns as text: comma-separated values with the names of the columns above them.

use servo_ident::move_check::{self, MoveFit};
use servo_ident::{DataError, Record};

/// Columns of a file, with the lines they stand in.
#[derive(Debug, Clone, PartialEq)]
pub struct Columns {
    names: Vec<String>,
    values: Vec<Vec<f64>>,
    /// Line number of each sample, from 1.
    lines: Vec<usize>,
}

/// What is wrong with a file, and in which line.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CsvError {
    /// No line with names.
    #[error("no header: expected a line `time_s,position_m,force_n` or `time_s,position_m,current_a`")]
    NoHeader,
    /// A column that is needed.
    #[error("line {line}: the header has no column {missing}; it has {found}")]
    Column {
        /// Line of the header.
        line: usize,
        /// What is missing.
        missing: &'static str,
        /// What is there.
        found: String,
    },
    /// A row that is too short or too long.
    #[error("line {line}: {found} fields, the header has {expected}")]
    Fields {
        /// Where.
        line: usize,
        /// How many there are.
        found: usize,
        /// How many there should be.
        expected: usize,
    },
    /// Not a number.
    #[error("line {line}: {field} = `{value}` is not a number")]
    NotANumber {
        /// Where.
        line: usize,
        /// The column.
        field: String,
        /// What stands there.
        value: String,
    },
    /// Numbers that a fit refuses, at a line.
    #[error("line {line}: {error}")]
    At {
        /// Where.
        line: usize,
        /// Why.
        error: DataError,
    },
    /// Numbers that a fit refuses.
    #[error(transparent)]
    Data(#[from] DataError),
    /// Mass and force constant go with a current.
    #[error("column current_a needs --mass and --force-constant: the friction force is K_t i - m a")]
    NoMass,
    /// A move is a matter of current.
    #[error("no column current_a: a move shows its mass by the current that it takes")]
    NoCurrent,
    /// Mass and force constant without a current.
    #[error("--mass and --force-constant go with a column current_a; force_n is the friction force itself")]
    MassWithForce,
}

impl Columns {
    /// Reads a file's text. Lines that begin with `#` are comments, but the last of them may hold the names; empty lines do not count.
    ///
    /// # Errors
    /// The first wrong thing, with its line.
    pub fn parse(text: &str) -> Result<Columns, CsvError> {
        let mut header: Option<(usize, Vec<String>)> = None;
        let mut columns = Columns { names: Vec::new(), values: Vec::new(), lines: Vec::new() };
        for (index, content) in text.trim_start_matches('\u{feff}').lines().enumerate() {
            let (line, content) = (index + 1, content.trim());
            if content.is_empty() {
                continue;
            }
            let (comment, content) = match content.strip_prefix('#') {
                Some(rest) => (true, rest),
                None => (false, content),
            };
            let fields: Vec<&str> = content.split(',').map(str::trim).collect();
            if columns.names.is_empty() && fields.contains(&TIME) {
                header = Some((line, fields.iter().map(|&name| name.to_owned()).collect()));
                continue;
            }
            if comment {
                continue;
            }
            let (_, names) = header.as_ref().ok_or(CsvError::NoHeader)?;
            if columns.names.is_empty() {
                columns.names = names.clone();
                columns.values = vec![Vec::new(); names.len()];
            }
            if fields.len() != names.len() {
                return Err(CsvError::Fields { line, found: fields.len(), expected: names.len() });
            }
            for ((field, name), column) in fields.iter().zip(names).zip(&mut columns.values) {
                let not_a_number = |_| CsvError::NotANumber { line, field: name.clone(), value: (*field).to_owned() };
                column.push(field.parse().map_err(not_a_number)?);
            }
            columns.lines.push(line);
        }
        let (line, names) = header.ok_or(CsvError::NoHeader)?;
        if columns.names.is_empty() {
            (columns.values, columns.names) = (vec![Vec::new(); names.len()], names);
        }
        let missing = |missing| CsvError::Column { line, missing, found: columns.names.join(",") };
        for name in [TIME, POSITION] {
            columns.column(name).ok_or_else(|| missing(name))?;
        }
        if columns.column(FORCE).is_none() && columns.column(CURRENT).is_none() {
            return Err(missing("force_n or current_a"));
        }
        Ok(columns)
    }

    /// A column by its name.
    pub fn column(&self, name: &str) -> Option<&[f64]> {
        let index = self.names.iter().position(|n| n == name)?;
        self.values.get(index).map(Vec::as_slice)
    }

    /// The friction in the columns: `force_n`, or `current_a` less the inertia.
    ///
    /// # Errors
    /// Data that are refused, with their line; mass (kg) and force constant (N/A) missing or too many.
    pub fn friction(&self, mass_kg: Option<f64>, force_constant_n_per_a: Option<f64>) -> Result<Record, CsvError> {
        let of = |name| self.column(name).unwrap_or(&[]);
        let record = match (self.column(FORCE), mass_kg, force_constant_n_per_a) {
            (Some(force_n), None, None) => Record::from_force(of(TIME), of(POSITION), force_n),
            (Some(_), ..) => return Err(CsvError::MassWithForce),
            (None, Some(mass_kg), Some(force_constant_n_per_a)) => {
                Record::from_current(of(TIME), of(POSITION), of(CURRENT), mass_kg, force_constant_n_per_a)
            }
            (None, ..) => return Err(CsvError::NoMass),
        };
        record.map_err(|error| self.at_line(error))
    }

    /// Mass and friction of moves in the columns, with `current_a`.
    ///
    /// # Errors
    /// As for [`Columns::friction`].
    pub fn moves(&self, force_constant_n_per_a: f64) -> Result<MoveFit, CsvError> {
        let of = |name| self.column(name).unwrap_or(&[]);
        let current_a = self.column(CURRENT).ok_or(CsvError::NoCurrent)?;
        move_check::fit(of(TIME), of(POSITION), current_a, force_constant_n_per_a).map_err(|error| self.at_line(error))
    }

    fn at_line(&self, error: DataError) -> CsvError {
        match error.sample().and_then(|sample| self.lines.get(sample)) {
            Some(&line) => CsvError::At { line, error },
            None => CsvError::Data(error),
        }
    }
}

const TIME: &str = "time_s";
const POSITION: &str = "position_m";
const FORCE: &str = "force_n";
const CURRENT: &str = "current_a";

#[cfg(test)]
mod tests {
    use super::*;

    const HEADER: &str = "time_s,position_m,force_n\n";

    fn sine(samples: usize) -> String {
        let row = |i: usize| {
            let phase = std::f64::consts::TAU * i as f64 / 200.0;
            format!("{:.6},{:.3e},{:.6}\n", i as f64 * 125e-6, 1e-6 * phase.sin(), 0.5 * phase.cos())
        };
        (0..samples).map(row).collect()
    }

    #[test]
    fn comments_empty_lines_spaces_and_order_do_not_matter() {
        let plain = Columns::parse(&format!("{HEADER}1,2,3\n4,5,6\n")).unwrap();
        assert_eq!(plain.column("force_n"), Some(&[3.0, 6.0][..]));
        for text in [
            "# drive 7, serial 12\n#\n\ntime_s,position_m,force_n\n1,2,3\n\n4,5,6\n",
            "# time_s,position_m,force_n\n1,2,3\n# pause\n4,5,6",
            "\u{feff}time_s , position_m, force_n\r\n1, 2 ,3\r\n4,5,6\r\n",
            "force_n,time_s,position_m\n3,1,2\n6,4,5\n",
        ] {
            let columns = Columns::parse(text).unwrap();
            for name in ["time_s", "position_m", "force_n"] {
                assert_eq!(columns.column(name), plain.column(name), "{text:?}");
            }
        }
    }

    #[test]
    fn what_is_no_such_file_is_refused_with_its_line() {
        for (text, message) in [
            ("", "no header: expected a line `time_s,position_m,force_n` or `time_s,position_m,current_a`"),
            ("1,2,3\n", "no header: expected a line `time_s,position_m,force_n` or `time_s,position_m,current_a`"),
            (
                "\ntime_s,position_m\n",
                "line 2: the header has no column force_n or current_a; it has time_s,position_m",
            ),
            ("time_s,force_n\n", "line 1: the header has no column position_m; it has time_s,force_n"),
            ("time_s,position_m,force_n\n1,2,3\n1,2\n", "line 3: 2 fields, the header has 3"),
            ("time_s,position_m,force_n\n#\n1,2 m,3\n", "line 3: position_m = `2 m` is not a number"),
        ] {
            assert_eq!(Columns::parse(text).unwrap_err().to_string(), message, "{text:?}");
        }
    }

    #[test]
    fn data_that_a_fit_refuses_are_named_with_their_line() {
        let refusal = |text: String| Columns::parse(&text).unwrap().friction(None, None).unwrap_err().to_string();
        let rows = sine(1000);
        let mut lines: Vec<&str> = rows.lines().collect();
        lines[2] = "0.000250,nan,0.5";
        let nan = lines.join("\n");
        assert_eq!(refusal(format!("# one\n{HEADER}{nan}")), "line 5: position_m = NaN is not a finite number");
        let dropped = rows.replacen("0.000500", "#0.000500", 1);
        assert_eq!(
            refusal(format!("{HEADER}{dropped}")),
            "line 7: time_s = 0.000625: a gap of 0.000250000 s before it, dropped samples; the others are 0.000125000 s apart"
        );
        assert_eq!(refusal(HEADER.to_owned()), "samples = 0 is too few: 100 or more are needed");
    }

    #[test]
    fn a_current_needs_mass_and_force_constant_and_a_force_must_not_have_them() {
        let force = Columns::parse(&format!("{HEADER}{}", sine(1000))).unwrap();
        assert!(force.friction(None, None).is_ok());
        assert_eq!(force.friction(Some(1.8), None), Err(CsvError::MassWithForce));
        let current = Columns::parse(&format!("{}{}", HEADER.replace("force_n", "current_a"), sine(1000))).unwrap();
        assert!(current.friction(Some(1.8), Some(7.8)).is_ok());
        for given in [(None, None), (Some(1.8), None), (None, Some(7.8))] {
            assert_eq!(current.friction(given.0, given.1), Err(CsvError::NoMass));
        }
        let message = current.friction(Some(-1.0), Some(7.8)).unwrap_err().to_string();
        assert_eq!(message, "mass = -1 is outside 0.001 to 10000.0");
    }
}
