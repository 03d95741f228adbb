//! A table: written as Markdown, CSV (unrounded), LaTeX (booktabs) and HTML.
use crate::{figures::escape, interval::Interval};
use std::fmt::Write;

/// A cell of a table.
#[derive(Debug, Clone, PartialEq)]
pub enum Cell {
    /// Words.
    Text(String),
    /// A count.
    Count(u64),
    /// A number and how many decimals are printed.
    Number(f64, usize),
    /// An interval and how many decimals are printed.
    Range(Interval, usize),
    /// How a value stands to another, and whether that is good (`None` for neither).
    Verdict(&'static str, Option<bool>),
    /// What is undefined: printed `-`, empty in CSV.
    Undefined,
}

impl Cell {
    /// A number, or undefined.
    #[must_use]
    pub fn number(value: Option<f64>, digits: usize) -> Self {
        value.map_or(Self::Undefined, |v| Self::Number(v, digits))
    }

    /// An interval, or undefined.
    #[must_use]
    pub fn range(value: Option<Interval>, digits: usize) -> Self {
        value.map_or(Self::Undefined, |v| Self::Range(v, digits))
    }

    /// Words.
    #[must_use]
    pub fn text(words: impl Into<String>) -> Self {
        Self::Text(words.into())
    }

    /// As printed, rounding half up.
    #[must_use]
    pub fn printed(&self) -> String {
        match self {
            Self::Text(t) => t.clone(),
            Self::Count(n) => n.to_string(),
            Self::Number(v, digits) => rounded(*v, *digits),
            Self::Verdict(word, _) => (*word).to_owned(),
            // A minus sign and a dash would be read as one.
            Self::Range([lo, hi], digits) if *lo < 0.0 => format!("{} to {}", rounded(*lo, *digits), rounded(*hi, *digits)),
            Self::Range([lo, hi], digits) => format!("{}-{}", rounded(*lo, *digits), rounded(*hi, *digits)),
            Self::Undefined => "-".into(),
        }
    }

    fn unrounded(&self) -> String {
        match self {
            Self::Text(t) if t.contains([',', '"', '\n']) => format!("\"{}\"", t.replace('"', "\"\"")),
            Self::Text(t) => t.clone(),
            Self::Count(n) => n.to_string(),
            Self::Number(v, _) => v.to_string(),
            Self::Verdict(word, _) => (*word).to_owned(),
            Self::Range([lo, hi], _) => format!("{lo} {hi}"),
            Self::Undefined => String::new(),
        }
    }
}

/// Half up, as the paper rounds; the small addition undoes the error of binary fractions.
#[must_use]
pub fn rounded(v: f64, digits: usize) -> String {
    let scale = 10f64.powi(digits as i32);
    format!("{:.digits$}", (v * scale + 0.5 + 1e-9).floor() / scale)
}

/// Rows of cells under headings.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Table {
    /// What the table shows, one sentence.
    pub caption: String,
    /// One a column.
    pub columns: Vec<String>,
    /// Each as long as `columns`.
    pub rows: Vec<Vec<Cell>>,
    /// Below the table.
    pub notes: Vec<String>,
}

impl Table {
    /// An empty table.
    #[must_use]
    pub fn new(caption: impl Into<String>, columns: &[&str]) -> Self {
        Self { caption: caption.into(), columns: columns.iter().map(ToString::to_string).collect(), ..Self::default() }
    }

    /// True for a column of words, which stands left; numbers stand right.
    fn is_text(&self, column: usize) -> bool {
        self.rows.iter().any(|r| matches!(r.get(column), Some(Cell::Text(t)) if !t.is_empty()))
    }

    /// Markdown, with columns aligned for reading as plain text.
    #[must_use]
    pub fn markdown(&self) -> String {
        let body: Vec<Vec<String>> = self.rows.iter().map(|r| r.iter().map(|c| c.printed().replace('|', "\\|")).collect()).collect();
        let width =
            |k: usize| body.iter().filter_map(|r| r.get(k)).chain([&self.columns[k]]).map(|t| t.chars().count()).max().unwrap_or(0).max(3);
        let widths: Vec<usize> = (0..self.columns.len()).map(width).collect();
        let line = |cells: &[String]| -> String {
            let padded = cells.iter().enumerate().map(|(k, c)| {
                let pad = " ".repeat(widths[k].saturating_sub(c.chars().count()));
                if self.is_text(k) { format!("{c}{pad}") } else { format!("{pad}{c}") }
            });
            format!("| {} |\n", padded.collect::<Vec<_>>().join(" | "))
        };
        let mut out = format!("{}\n\n{}", self.caption, line(&self.columns));
        let rule =
            (0..widths.len()).map(|k| if self.is_text(k) { "-".repeat(widths[k]) } else { format!("{}:", "-".repeat(widths[k] - 1)) });
        out += &line(&rule.collect::<Vec<_>>());
        body.iter().for_each(|row| out += &line(row));
        self.notes.iter().for_each(|note| out += &format!("\n{note}\n"));
        out
    }

    /// Comma-separated values, unrounded; an interval as two numbers with a space between.
    #[must_use]
    pub fn csv(&self) -> String {
        let mut out = self.columns.iter().map(|c| Cell::text(c).unrounded()).collect::<Vec<_>>().join(",") + "\n";
        for row in &self.rows {
            out += &(row.iter().map(Cell::unrounded).collect::<Vec<_>>().join(",") + "\n");
        }
        out
    }

    /// LaTeX, for the package booktabs.
    #[must_use]
    pub fn latex(&self, label: &str) -> String {
        let align: String = (0..self.columns.len()).map(|k| if self.is_text(k) { 'l' } else { 'r' }).collect();
        let line = |cells: Vec<String>| cells.iter().map(|c| latex_escape(c)).collect::<Vec<_>>().join(" & ") + r" \\" + "\n";
        let mut out = format!("\\begin{{table}}\n\\centering\n\\caption{{{}}}\n\\label{{tab:{label}}}\n", latex_escape(&self.caption));
        let _ = write!(out, "\\begin{{tabular}}{{{align}}}\n\\toprule\n{}\\midrule\n", line(self.columns.clone()));
        for row in &self.rows {
            out += &line(row.iter().map(Cell::printed).collect());
        }
        out += "\\bottomrule\n\\end{tabular}\n";
        self.notes.iter().for_each(|note| out += &format!("\\par\\footnotesize {}\n", latex_escape(note)));
        out + "\\end{table}\n"
    }

    /// An HTML table.
    #[must_use]
    pub fn html(&self) -> String {
        let mut out =
            format!("<figure class=\"table\"><figcaption>{}</figcaption><div class=\"scroll\"><table><thead><tr>", escape(&self.caption));
        let class = |k: usize| if self.is_text(k) { " class=\"l\"" } else { "" };
        for (k, column) in self.columns.iter().enumerate() {
            let _ = write!(out, "<th{}>{}</th>", class(k), escape(column));
        }
        out += "</tr></thead><tbody>";
        for row in &self.rows {
            out += "<tr>";
            for (k, cell) in row.iter().enumerate() {
                let text = cell.printed();
                let verdict = match cell {
                    Cell::Verdict(_, Some(true)) => " data-v=\"better\"",
                    Cell::Verdict(_, Some(false)) => " data-v=\"worse\"",
                    _ => "",
                };
                let _ = write!(out, "<td{}{verdict}>{}</td>", class(k), escape(&text));
            }
            out += "</tr>";
        }
        out += "</tbody></table></div>";
        self.notes.iter().for_each(|note| out += &format!("<p class=\"note\">{}</p>", escape(note)));
        out + "</figure>"
    }
}

fn latex_escape(text: &str) -> String {
    let mut out = String::new();
    for c in text.chars() {
        match c {
            '%' | '&' | '#' | '_' | '$' | '{' | '}' => out.extend(['\\', c]),
            '\\' => out += "\\textbackslash{}",
            '>' => out += "$>$",
            '<' => out += "$<$",
            '~' => out += "\\textasciitilde{}",
            '^' => out += "\\textasciicircum{}",
            _ => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> Table {
        let mut t = Table::new("A caption of 5 %.", &["what", "n", "rate", "95 %"]);
        t.rows.push(vec![Cell::text("a, b"), Cell::Count(3), Cell::Number(0.9445, 3), Cell::Range([0.1, 0.2], 2)]);
        t.rows.push(vec![Cell::text("none"), Cell::Count(0), Cell::Undefined, Cell::Undefined]);
        t
    }

    #[test]
    fn four_forms_of_one_table() {
        let t = table();
        assert!(t.markdown().contains("| a, b | "));
        assert!(t.markdown().contains("| ---- | --: |"), "{}", t.markdown());
        assert_eq!(t.csv(), "what,n,rate,95 %\n\"a, b\",3,0.9445,0.1 0.2\nnone,0,,\n");
        assert!(t.latex("x").contains("a, b & 3 & 0.945 & 0.10-0.20 \\\\"), "{}", t.latex("x"));
        assert!(t.html().contains("<td>0.945</td>"));
    }

    #[test]
    fn rounds_half_up() {
        assert_eq!(rounded(0.0625, 3), "0.063");
        assert_eq!(rounded(0.945, 2), "0.95");
        assert_eq!(rounded(2.0, 0), "2");
    }
}
