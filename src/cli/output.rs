//! Text on stdout: numbers as people read them, tables, JSON.

use std::fmt::Write as _;
use std::io::{ErrorKind, Write as _};

use super::error::{CliError, Exit};

/// Prints a result. A reader that has seen enough (`| head`) is no error.
pub(crate) fn print(text: &str) -> Result<(), CliError> {
    let mut stdout = std::io::stdout().lock();
    match stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(CliError::new(
            Exit::BadInput,
            anyhow::anyhow!("cannot write to the standard output: {error}"),
        )),
        _ => Ok(()),
    }
}

/// Prints a JSON document.
pub(crate) fn print_json(value: &serde_json::Value) -> Result<(), CliError> {
    print(&format!("{value:#}\n"))
}

/// A count with its digits in groups of three.
pub(crate) fn count(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::with_capacity(digits.len() * 4 / 3);
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// A count with its noun, which takes an s where there is not one.
pub(crate) fn counted(number: u64, noun: &str) -> String {
    let ending = if number == 1 { "" } else { "s" };
    format!("{} {noun}{ending}", count(number))
}

/// A size in bytes with a binary unit.
pub(crate) fn bytes(number: u64) -> String {
    const UNITS: [&str; 5] = ["B", "KiB", "MiB", "GiB", "TiB"];
    let mut value = number as f64;
    let mut unit = 0;
    while value >= 1000.0 && unit + 1 < UNITS.len() {
        value /= 1024.0;
        unit += 1;
    }
    let decimals = if unit == 0 || value >= 100.0 { 0 } else { 1 };
    format!("{value:.decimals$} {}", UNITS[unit])
}

/// A length in metres with a unit that suits it.
pub(crate) fn length(metres: f64) -> String {
    let (value, unit) = match metres.abs() {
        m if m >= 1000.0 => (metres / 1000.0, "km"),
        m if m >= 1.0 || m == 0.0 => (metres, "m"),
        m if m >= 0.01 => (metres * 100.0, "cm"),
        _ => (metres * 1000.0, "mm"),
    };
    let digits = if value.abs() >= 100.0 { 1 } else { 3 };
    format!("{value:.digits$} {unit}")
}

/// How many times smaller a size became.
pub(crate) fn ratio(raw_bytes: u64, stored_bytes: u64) -> String {
    if stored_bytes == 0 {
        "–".to_owned()
    } else {
        format!("{:.2}×", raw_bytes as f64 / stored_bytes as f64)
    }
}

/// A table with aligned columns: the first to the left, the others to the right. The first row is the head.
#[derive(Default)]
pub(crate) struct Table {
    rows: Vec<Vec<String>>,
}

impl Table {
    /// A table with the names of its columns.
    pub(crate) fn new<const N: usize>(head: [&str; N]) -> Self {
        Self { rows: vec![head.map(str::to_owned).to_vec()] }
    }

    /// Appends a row.
    pub(crate) fn row<const N: usize>(&mut self, cells: [String; N]) {
        self.rows.push(cells.to_vec());
    }

    /// The lines, each indented by two spaces.
    pub(crate) fn render(&self) -> String {
        let columns = self.rows.iter().map(Vec::len).max().unwrap_or(0);
        let width = |column: usize| {
            self.rows
                .iter()
                .filter_map(|row| row.get(column))
                .map(|cell| cell.chars().count())
                .max()
                .unwrap_or(0)
        };
        let widths: Vec<_> = (0..columns).map(width).collect();
        let mut text = String::new();
        for row in &self.rows {
            let mut line = String::new();
            for (column, cell) in row.iter().enumerate() {
                let width = widths[column];
                _ = if column == 0 {
                    write!(line, "  {cell:<width$}")
                } else {
                    write!(line, "  {cell:>width$}")
                };
            }
            text.push_str(line.trim_end());
            text.push('\n');
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_read_well() {
        assert_eq!(count(0), "0");
        assert_eq!(count(999), "999");
        assert_eq!(count(1000), "1,000");
        assert_eq!(count(1234567), "1,234,567");
        assert_eq!(bytes(0), "0 B");
        assert_eq!(bytes(1536), "1.5 KiB");
        assert_eq!(bytes(300 << 20), "300 MiB");
        assert_eq!(length(0.0195), "1.950 cm");
        assert_eq!(ratio(10, 4), "2.50×");
        assert_eq!(counted(1, "level"), "1 level");
        assert_eq!(counted(0, "level"), "0 levels");
    }

    #[test]
    fn columns_are_aligned() {
        let mut table = Table::new(["name", "size"]);
        table.row(["é".to_owned(), "1".to_owned()]);
        table.row(["longer".to_owned(), "12345".to_owned()]);
        assert_eq!(table.render(), "  name     size\n  é           1\n  longer  12345\n");
    }
}
