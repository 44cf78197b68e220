//! Small plots of results as SVG: lines over a number, or bars over names.
//!
//! The same data give the same bytes. A plot follows the reader's light or dark theme where it is shown, and tells its
//! series apart by marks and dashes as well as by colour.

use std::fmt::Write as _;

/// How a value becomes a place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scale {
    /// In proportion, from 0.
    Linear,
    /// By its logarithm; values that have none are left out.
    Log,
}

/// One line, or one bar of each group.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// Its name in the legend.
    pub name: String,
    /// x and y; of bars, x is the index of the group.
    pub points: Vec<(f64, f64)>,
}

/// What stands along x.
#[derive(Debug, Clone, PartialEq)]
pub enum Across {
    /// Numbers: the series are lines.
    Numbers(Scale),
    /// Names of groups: the series are bars.
    Names(Vec<String>),
}

/// A plot.
#[derive(Debug, Clone, PartialEq)]
pub struct Plot {
    /// Stem of its file.
    pub name: String,
    /// What it shows.
    pub title: String,
    /// What x is, unit included.
    pub x_label: String,
    /// What y is, unit included.
    pub y_label: String,
    /// Along x.
    pub across: Across,
    /// Along y.
    pub y_scale: Scale,
    /// What is drawn.
    pub series: Vec<Series>,
}

const WIDTH: f64 = 760.0;
const HEIGHT: f64 = 400.0;
const LEFT: f64 = 70.0;
const RIGHT: f64 = 560.0;
const TOP: f64 = 48.0;
const BOTTOM: f64 = 340.0;

/// Colours for the light and the dark theme, after M. Okabe and K. Ito, *Color Universal Design*, 2008.
const COLORS: [[&str; 2]; 7] = [
    ["#0068a8", "#56b4e9"],
    ["#c04a00", "#ff9a56"],
    ["#007a58", "#35d0a2"],
    ["#a8407c", "#f0a0cc"],
    ["#7a6000", "#e8d84a"],
    ["#5b4bb0", "#b3a6ff"],
    ["#505050", "#c0c0c0"],
];
const DASHES: [&str; 4] = ["", "7 4", "2 3", "9 3 2 3"];

impl Plot {
    /// The plot as an SVG document.
    pub fn svg(&self) -> String {
        let mut svg = String::new();
        _ = write!(
            svg,
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{WIDTH}\" height=\"{HEIGHT}\" viewBox=\"0 0 {WIDTH} \
             {HEIGHT}\" role=\"img\" font-family=\"system-ui, sans-serif\" font-size=\"13\">\n<title>{}</title>\n",
            escaped(&self.title)
        );
        svg.push_str(&style());
        _ = writeln!(svg, "<rect class=\"paper\" width=\"{WIDTH}\" height=\"{HEIGHT}\"/>");
        text(&mut svg, LEFT, 26.0, "start", "font-size=\"15\" font-weight=\"600\"", &self.title);
        let y = self.y_axis();
        for &(value, ref label) in &y.ticks {
            let at = y.place(value, BOTTOM, TOP);
            _ = writeln!(svg, "<path class=\"grid\" d=\"M{LEFT} {at:.1}H{RIGHT}\"/>");
            text(&mut svg, LEFT - 8.0, at + 4.5, "end", "", label);
        }
        _ = writeln!(svg, "<path class=\"axis\" d=\"M{LEFT} {BOTTOM}H{RIGHT}\"/>");
        let middle = (LEFT + RIGHT) / 2.0;
        text(&mut svg, middle, HEIGHT - 16.0, "middle", "", &self.x_label);
        let turned = format!("transform=\"rotate(-90 18 {0})\"", (TOP + BOTTOM) / 2.0);
        text(&mut svg, 18.0, (TOP + BOTTOM) / 2.0, "middle", &turned, &self.y_label);
        match &self.across {
            Across::Numbers(scale) => self.lines(&mut svg, *scale, &y),
            Across::Names(names) => self.bars(&mut svg, names, &y),
        }
        for (index, series) in self.series.iter().enumerate() {
            let at = TOP + 12.0 + 22.0 * index as f64;
            let (from, to) = (RIGHT + 18.0, RIGHT + 46.0);
            match self.across {
                Across::Numbers(_) => {
                    _ = writeln!(
                        svg,
                        "<path class=\"line s{}\"{} d=\"M{from} {at}H{to}\"/>",
                        color(index),
                        dash(index)
                    );
                    mark(&mut svg, index, (from + to) / 2.0, at);
                }
                Across::Names(_) => {
                    let top = at - 7.0;
                    _ = writeln!(
                        svg,
                        "<rect class=\"f{}\" x=\"{from}\" y=\"{top}\" width=\"28\" height=\"14\"/>",
                        color(index)
                    );
                }
            }
            text(&mut svg, to + 8.0, at + 4.5, "start", "", &series.name);
        }
        svg.push_str("</svg>\n");
        svg
    }

    fn y_axis(&self) -> PlacedAxis {
        let values = self.series.iter().flat_map(|series| series.points.iter().map(|point| point.1));
        PlacedAxis::new(self.y_scale, values)
    }

    fn lines(&self, svg: &mut String, scale: Scale, y: &PlacedAxis) {
        let values = self.series.iter().flat_map(|series| series.points.iter().map(|point| point.0));
        let mut x = PlacedAxis::new(scale, values.clone());
        if scale == Scale::Log {
            // The values that were measured say more than powers of ten.
            let mut known: Vec<f64> = values.filter(|v| x.shows(*v)).collect();
            known.sort_by(f64::total_cmp);
            known.dedup();
            if let [first, .., last] = known.as_slice() {
                (x.from, x.to) = (first.ln(), last.ln());
            }
            x.ticks = known.into_iter().map(|value| (value, number(value))).collect();
        }
        let x_of = |value| x.place(value, LEFT + 16.0, RIGHT - 16.0);
        for &(value, ref label) in &x.ticks {
            let at = x_of(value);
            _ = writeln!(svg, "<path class=\"axis\" d=\"M{at:.1} {BOTTOM}v5\"/>");
            text(svg, at, BOTTOM + 20.0, "middle", "", label);
        }
        for (index, series) in self.series.iter().enumerate() {
            let shown = series.points.iter().filter(|point| x.shows(point.0) && y.shows(point.1));
            let places: Vec<[f64; 2]> =
                shown.map(|point| [x_of(point.0), y.place(point.1, BOTTOM, TOP)]).collect();
            let line: Vec<_> = places.iter().map(|[x, y]| format!("{x:.1} {y:.1}")).collect();
            if line.len() > 1 {
                let (color, dash, line) = (color(index), dash(index), line.join("L"));
                _ = writeln!(svg, "<path class=\"line s{color}\"{dash} d=\"M{line}\"/>");
            }
            for [x, y] in places {
                mark(svg, index, x, y);
            }
        }
    }

    fn bars(&self, svg: &mut String, names: &[String], y: &PlacedAxis) {
        let group = (RIGHT - LEFT) / names.len().max(1) as f64;
        let bar = group * 0.8 / self.series.len().max(1) as f64;
        for (index, name) in names.iter().enumerate() {
            let middle = LEFT + group * (index as f64 + 0.5);
            text(svg, middle, BOTTOM + 20.0, "middle", "", name);
        }
        for (index, series) in self.series.iter().enumerate() {
            for &(at, value) in series.points.iter().filter(|point| y.shows(point.1)) {
                let left = LEFT + group * (at + 0.1) + bar * index as f64;
                let top = y.place(value, BOTTOM, TOP);
                let (color, width, height) = (color(index), bar * 0.94, (BOTTOM - top).max(0.0));
                _ = writeln!(
                    svg,
                    "<rect class=\"f{color}\" x=\"{left:.1}\" y=\"{top:.1}\" width=\"{width:.1}\" height=\"{height:.1}\"/>"
                );
                let small = "font-size=\"10\"";
                text(svg, left + bar * 0.47, top - 4.0, "middle", small, &number(value));
            }
        }
    }
}

/// An axis with its range and ticks.
struct PlacedAxis {
    scale: Scale,
    /// Ends of the range; logarithms on a logarithmic axis.
    from: f64,
    to: f64,
    ticks: Vec<(f64, String)>,
}

impl PlacedAxis {
    fn new(scale: Scale, values: impl Iterator<Item = f64>) -> Self {
        let shown = values.filter(|value| value.is_finite() && (scale == Scale::Linear || *value > 0.0));
        let (min, max) = shown.fold((f64::INFINITY, 0.0f64), |(min, max), v| (min.min(v), max.max(v)));
        match scale {
            Scale::Linear => {
                let step = nice_step(if max > 0.0 { max } else { 1.0 });
                let count = (max / step).ceil().max(1.0) as u32;
                let ticks = (0..=count).map(|i| f64::from(i) * step).map(|v| (v, number(v))).collect();
                Self { scale, from: 0.0, to: f64::from(count) * step, ticks }
            }
            Scale::Log => {
                let (min, max) = if max > 0.0 { (min, max) } else { (1.0, 10.0) };
                let mut first = 1.0;
                while first > min {
                    first /= 10.0;
                }
                while first * 10.0 <= min {
                    first *= 10.0;
                }
                let mut ticks = vec![first];
                while ticks[ticks.len() - 1] < max {
                    ticks.push(ticks[ticks.len() - 1] * 10.0);
                }
                if ticks.len() == 1 {
                    ticks.push(first * 10.0);
                }
                let (from, to) = (first.ln(), ticks[ticks.len() - 1].ln());
                Self { scale, from, to, ticks: ticks.into_iter().map(|v| (v, number(v))).collect() }
            }
        }
    }

    fn shows(&self, value: f64) -> bool {
        value.is_finite() && (self.scale == Scale::Linear || value > 0.0)
    }

    fn place(&self, value: f64, start: f64, end: f64) -> f64 {
        let value = if self.scale == Scale::Log { value.ln() } else { value };
        let share = if self.to > self.from { (value - self.from) / (self.to - self.from) } else { 0.5 };
        start + (end - start) * share
    }
}

/// 1, 2 or 5 times a power of ten, so that about five steps reach `max`.
fn nice_step(max: f64) -> f64 {
    let mut power = 1.0;
    while power * 10.0 <= max {
        power *= 10.0;
    }
    while power > max {
        power /= 10.0;
    }
    [0.2, 0.5, 1.0, 2.0]
        .map(|part| part * power)
        .into_iter()
        .find(|step| max / step <= 6.0)
        .unwrap_or(2.0 * power)
}

/// A number as short as three digits allow.
fn number(value: f64) -> String {
    let (value, unit) = match value.abs() {
        v if v >= 1e9 => (value / 1e9, "G"),
        v if v >= 1e6 => (value / 1e6, "M"),
        v if v >= 1e4 => (value / 1e3, "k"),
        _ => (value, ""),
    };
    let decimals = match value.abs() {
        v if v >= 100.0 => 0,
        v if v >= 10.0 => 1,
        v if v >= 0.1 || v == 0.0 => 2,
        v if v >= 0.001 => 4,
        _ => 7,
    };
    let text = format!("{value:.decimals$}");
    let short = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    format!("{short}{unit}")
}

fn color(index: usize) -> usize {
    index % COLORS.len()
}

fn dash(index: usize) -> String {
    match DASHES[index % DASHES.len()] {
        "" => String::new(),
        dash => format!(" stroke-dasharray=\"{dash}\""),
    }
}

/// A mark of the series' own shape.
fn mark(svg: &mut String, index: usize, x: f64, y: f64) {
    let color = color(index);
    let shape = match index % 4 {
        0 => "m-4.5 0a4.5 4.5 0 0 0 9 0a4.5 4.5 0 0 0 -9 0z",
        1 => "m-4 -4h8v8h-8z",
        2 => "m0 -5l5 9h-10z",
        _ => "m0 -5.5l5.5 5.5l-5.5 5.5l-5.5 -5.5z",
    };
    _ = writeln!(svg, "<path class=\"f{color}\" d=\"M{x:.1} {y:.1}{shape}\"/>");
}

fn text(svg: &mut String, x: f64, y: f64, anchor: &str, more: &str, text: &str) {
    let more = if more.is_empty() { String::new() } else { format!(" {more}") };
    let text = escaped(text);
    _ = writeln!(
        svg,
        "<text class=\"ink\" x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\"{more}>{text}</text>"
    );
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

fn style() -> String {
    let theme = |dark: usize, [paper, ink, grid]: [&str; 3]| {
        let mut css = format!(
            ".paper{{fill:{paper}}}.ink{{fill:{ink}}}.grid{{stroke:{grid};fill:none}}.axis{{stroke:{ink};fill:none}}"
        );
        for (index, colors) in COLORS.iter().enumerate() {
            _ = write!(css, ".s{index}{{stroke:{0}}}.f{index}{{fill:{0}}}", colors[dark]);
        }
        css
    };
    let light = theme(0, ["#ffffff", "#1f2328", "#d8dde3"]);
    let dark = theme(1, ["#0d1117", "#e6edf3", "#30363d"]);
    format!(
        "<style>.line{{fill:none;stroke-width:2}}{light}@media (prefers-color-scheme:dark){{{dark}}}</style>\n"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plot(across: Across, y_scale: Scale) -> Plot {
        Plot {
            name: "p".to_owned(),
            title: "a < b & c".to_owned(),
            x_label: "lights".to_owned(),
            y_label: "ms".to_owned(),
            across,
            y_scale,
            series: vec![
                Series { name: "rows".to_owned(), points: vec![(0.0, 2.0), (1.0, 4.0)] },
                Series { name: "bvh".to_owned(), points: vec![(0.0, 8.0), (1.0, f64::NAN)] },
            ],
        }
    }

    #[test]
    fn bars_are_as_high_as_their_values() {
        let svg = plot(Across::Names(vec!["x".to_owned(), "y".to_owned()]), Scale::Linear).svg();
        // Steps of 2 up to 8 over 292 units: 2 is 73 high.
        assert!(svg.contains("height=\"73.0\"/>") && svg.contains("height=\"146.0\"/>"), "{svg}");
        assert!(svg.contains("height=\"292.0\"/>") && !svg.contains("NaN"), "{svg}");
        assert!(svg.contains("a &lt; b &amp; c"));
    }

    #[test]
    fn lines_skip_what_has_no_place() {
        let lines = plot(Across::Numbers(Scale::Linear), Scale::Linear).svg();
        assert_eq!(lines.matches("class=\"line").count(), 1 + 2, "one line of two points, two in the legend");
        let log = plot(Across::Numbers(Scale::Log), Scale::Log).svg();
        assert!(!log.contains("NaN") && !log.contains("inf"), "{log}");
        let empty = Plot { series: Vec::new(), ..plot(Across::Numbers(Scale::Log), Scale::Log) };
        assert!(!empty.svg().contains("NaN"));
    }

    #[test]
    fn numbers_are_short() {
        let texts = [0.0, 0.05, 1.0, 2.5, 38.2, 512.0, 1024.0, 10_000.0, 871_000.0, 1e7].map(number);
        assert_eq!(texts, ["0", "0.05", "1", "2.5", "38.2", "512", "1024", "10k", "871k", "10M"]);
        assert_eq!([7.0, 1.0, 0.9, 43.0, 100.0].map(nice_step), [2.0, 0.2, 0.2, 10.0, 20.0]);
    }
}
