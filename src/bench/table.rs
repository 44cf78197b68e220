//! Tables of results: for people (Markdown), for spreadsheets (CSV), for programs (JSON), with plots of them (SVG).

use super::plot::Plot;
use super::{BenchError, RunInfo};
use serde_json::{Map, Value, json};
use std::fmt::Write as _;
use std::path::Path;

/// One value of a table.
#[derive(Debug, Clone, PartialEq)]
pub enum Cell {
    /// A name.
    Text(String),
    /// A count.
    Count(u64),
    /// A number, and how many decimals people are shown.
    Number(f64, usize),
    /// Does not apply.
    None,
}

impl Cell {
    /// A share in per cent; [`Cell::None`] of nothing.
    pub fn percent(part: u64, whole: u64) -> Self {
        match whole {
            0 => Self::None,
            _ => Self::Number(100.0 * part as f64 / whole as f64, 2),
        }
    }

    fn text(&self) -> String {
        match self {
            Self::Text(text) => text.clone(),
            Self::Count(count) => count.to_string(),
            Self::Number(number, decimals) => format!("{number:.decimals$}"),
            Self::None => String::new(),
        }
    }

    fn json(&self) -> Value {
        match self {
            Self::Text(text) => json!(text),
            Self::Count(count) => json!(count),
            Self::Number(number, _) => json!(number),
            Self::None => Value::Null,
        }
    }
}

impl From<&str> for Cell {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

/// Rows of cells under the names of columns.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    /// Stem of the files it is written to.
    pub name: String,
    /// What it shows, in a sentence.
    pub title: String,
    /// Names of the columns, units included.
    pub columns: Vec<&'static str>,
    /// One cell per column each.
    pub rows: Vec<Vec<Cell>>,
    /// Pictures of it.
    pub plots: Vec<Plot>,
    /// What it was measured on, if it has times.
    pub run: Option<RunInfo>,
}

impl Table {
    /// An empty table.
    pub fn new(name: impl Into<String>, title: impl Into<String>, columns: &[&'static str]) -> Self {
        Self {
            name: name.into(),
            title: title.into(),
            columns: columns.to_vec(),
            rows: Vec::new(),
            plots: Vec::new(),
            run: None,
        }
    }

    /// Appends a row.
    ///
    /// # Panics
    /// If it has another number of cells than there are columns.
    pub fn push(&mut self, row: Vec<Cell>) {
        assert_eq!(row.len(), self.columns.len(), "one cell per column");
        self.rows.push(row);
    }

    /// The table in Markdown, its title above.
    pub fn markdown(&self) -> String {
        let mut text = format!("### {}\n\n| {} |\n|", self.title, self.columns.join(" | "));
        for column in 0..self.columns.len() {
            let named = self.rows.iter().any(|row| matches!(row[column], Cell::Text(_)));
            text.push_str(if named { "---|" } else { "---:|" });
        }
        for row in &self.rows {
            let cells: Vec<_> = row.iter().map(Cell::text).collect();
            _ = write!(text, "\n| {} |", cells.join(" | "));
        }
        text.push('\n');
        if let Some(run) = &self.run {
            _ = writeln!(text, "\n{}", run.text());
        }
        text
    }

    /// The table as comma-separated values with a head line; numbers in full.
    pub fn csv(&self) -> String {
        let quoted = |text: String| match text.contains([',', '"', '\n']) {
            true => format!("\"{}\"", text.replace('"', "\"\"")),
            false => text,
        };
        let mut text = self.columns.iter().map(|c| quoted((*c).to_owned())).collect::<Vec<_>>().join(",");
        for row in &self.rows {
            let cells: Vec<_> = row
                .iter()
                .map(|cell| match cell {
                    Cell::Number(number, _) => number.to_string(),
                    other => quoted(other.text()),
                })
                .collect();
            text.push('\n');
            text.push_str(&cells.join(","));
        }
        text.push('\n');
        text
    }

    /// The table as an object: title, what it was measured on, and one object per row.
    pub fn json(&self) -> Value {
        let rows: Vec<Value> = self
            .rows
            .iter()
            .map(|row| {
                let pairs = self.columns.iter().zip(row);
                Value::Object(pairs.map(|(c, cell)| ((*c).to_owned(), cell.json())).collect::<Map<_, _>>())
            })
            .collect();
        let mut table = json!({ "name": self.name, "title": self.title, "rows": rows });
        if let Some(run) = &self.run {
            table["run"] = run.json();
        }
        table
    }

    /// Writes `NAME.md`, `NAME.csv`, `NAME.json` and `PLOT.svg` for each plot into `folder`, which is made if need be.
    pub fn write(&self, folder: &Path) -> Result<(), BenchError> {
        let failed = |path: &Path| {
            let path = path.to_owned();
            move |source| BenchError::Output { path, source }
        };
        fs_err::create_dir_all(folder).map_err(failed(folder))?;
        let texts = [("md", self.markdown()), ("csv", self.csv()), ("json", format!("{:#}\n", self.json()))];
        let files = texts.into_iter().map(|(extension, text)| (&self.name, extension, text));
        let plots = self.plots.iter().map(|plot| (&plot.name, "svg", plot.svg()));
        for (name, extension, text) in files.chain(plots) {
            let path = folder.join(format!("{}.{extension}", name.replace([':', '/', '\\'], "-")));
            fs_err::write(&path, text).map_err(failed(&path))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::plot::{Across, Scale};

    #[test]
    fn one_table_reads_the_same_in_three_forms() {
        let mut table = Table::new("t", "Errors", &["scene", "eps_v %", "points"]);
        table.push(vec!["a, b".into(), Cell::Number(1.256, 1), Cell::Count(7)]);
        table.push(vec!["c".into(), Cell::percent(1, 0), Cell::Count(0)]);
        assert_eq!(
            table.markdown(),
            "### Errors\n\n| scene | eps_v % | points |\n|---|---:|---:|\n| a, b | 1.3 | 7 |\n| c |  | 0 |\n"
        );
        assert_eq!(table.csv(), "scene,eps_v %,points\n\"a, b\",1.256,7\nc,,0\n");
        assert_eq!(table.json()["rows"][0]["eps_v %"], json!(1.256));
        assert_eq!(table.json()["rows"][1]["eps_v %"], Value::Null);
    }

    #[test]
    fn files_are_written_side_by_side() {
        let folder = tempfile::tempdir().unwrap();
        let mut table = Table::new("town:1000", "Nothing", &["scene"]);
        table.run = Some(RunInfo::gather("manyview bench".to_owned(), None));
        table.plots.push(Plot {
            name: "town:1000-errors".to_owned(),
            title: "Nothing".to_owned(),
            x_label: String::new(),
            y_label: String::new(),
            across: Across::Names(Vec::new()),
            y_scale: Scale::Linear,
            series: Vec::new(),
        });
        table.write(&folder.path().join("new")).unwrap();
        for extension in ["md", "csv", "json"] {
            assert!(folder.path().join(format!("new/town-1000.{extension}")).exists());
        }
        assert!(folder.path().join("new/town-1000-errors.svg").exists());
        assert!(
            table.json()["run"]["command"] == "manyview bench"
                && table.markdown().contains("`manyview bench`")
        );
        let blocked = folder.path().join("new/town-1000.md");
        assert!(table.write(&blocked).unwrap_err().to_string().contains("town-1000.md"));
    }
}
