//! The table that a bench on an emulated board prints, and its section of the report.

use super::report;
use crate::command::{Done, Failure, cargo, output};

/// The rows under a head.
pub(crate) struct Table {
    head: Vec<String>,
    rows: Vec<TableRow>,
}

/// One row.
struct TableRow {
    figure: usize,
    is_required: bool,
    /// The fields from the law on.
    fields: Vec<String>,
}

impl TableRow {
    fn verdict(&self) -> &str {
        self.fields.last().map_or("", String::as_str)
    }

    fn holds(&self) -> bool {
        self.verdict() == "holds"
    }
}

impl Table {
    /// Runs a bench of the package `pulsetrain`. Gives its table, and its lines that are limits for the table of
    /// boards.
    pub(crate) fn measured(bench: &str, arguments: &str) -> Done<(Table, Vec<String>)> {
        let text = output(&mut cargo(&format!("bench --package pulsetrain --bench {bench} {arguments}")))?;
        let mut lines = text.lines().filter(|line| line.contains('\t'));
        let head = lines.next().ok_or_else(|| Failure::Check("the bench printed no table".to_owned()))?;
        let head = head.split('\t').skip(2).map(str::to_owned).collect();
        let (limits, rows): (Vec<_>, Vec<_>) = lines.partition(|line| line.starts_with("limit\t"));
        let rows = rows.into_iter().map(parse).collect::<Done<_>>()?;
        Ok((Table { head, rows }, limits.into_iter().map(str::to_owned).collect()))
    }

    /// A table for each figure that has rows. `titles` count from figure 1.
    pub(crate) fn markdown(&self, board: &str, titles: &[&str]) -> String {
        let mut text = String::new();
        for (figure, title) in (1..).zip(titles) {
            let rows: Vec<_> = self.rows.iter().filter(|row| row.figure == figure).collect();
            if rows.is_empty() {
                continue;
            }
            text.push_str(&format!("\n## {board}, figure {figure}: {title}\n\n"));
            text.push_str(&format!("| {} |\n|{}\n", self.head.join(" | "), "---|".repeat(self.head.len())));
            for row in rows {
                text.push_str(&format!("| {} |\n", row.fields.join(" | ")));
            }
        }
        text
    }

    /// Prints and writes a section. Fails if a promise does not hold, but only after writing.
    pub(crate) fn finish(&self, section: &str, text: &str) -> Done {
        print!("{text}");
        report::write(section, text)?;
        let broken: Vec<_> = self.rows.iter().filter(|row| row.is_required && !row.holds()).collect();
        if broken.is_empty() {
            return Ok(());
        }
        let lines = broken
            .iter()
            .map(|row| format!("\n  {}: {}", row.fields[..row.fields.len().min(4)].join(", "), row.verdict()));
        Err(Failure::Check(format!(
            "{} of the promised figures do not hold:{}",
            broken.len(),
            lines.collect::<String>()
        )))
    }
}

fn parse(line: &str) -> Done<TableRow> {
    let bad = || Failure::Check(format!("not a row of figures: {line}"));
    let mut fields = line.split('\t').map(str::to_owned);
    let is_required = fields.next().and_then(|text| text.parse().ok()).ok_or_else(bad)?;
    let figure = fields.next().and_then(|text| text.parse().ok()).ok_or_else(bad)?;
    Ok(TableRow { figure, is_required, fields: fields.collect() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_is_read_as_it_was_written() {
        let row = parse("true\t2\tchanging ±10 %\t1.0 µs\t8/9\tholds").expect("a row");
        assert!(row.is_required && row.holds());
        assert_eq!((row.figure, row.fields[0].as_str()), (2, "changing ±10 %"));
        assert!(parse("maybe\t2\tx").is_err());
        let table = Table { head: vec!["law".to_owned()], rows: vec![row] };
        let text = table.markdown("Uno", &["The first", "The second"]);
        assert!(text.starts_with("\n## Uno, figure 2: The second\n"), "{text}");
    }
}
