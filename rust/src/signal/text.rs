//! Columns of numbers from delimited text, fast where the text is plain.
//!
//! Anything unusual (a quote, an empty cell, a line of another length, a value that is not a finite number) ends it without a result. The
//! caller then reads the text by a slower parser, which reports the error.

use crate::ground::parallel;

/// Separator of cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Delimiter {
    /// Runs of blanks and tabs.
    Blanks,
    /// One character; blanks around numbers mean nothing.
    Byte(u8),
}

/// Bytes below which a part of a text is not worth a thread: a millisecond.
const PART: usize = 1 << 17;

/// The `wanted` columns (ascending, from 0) of text whose lines all have `columns` cells, row-major; None where it is not plain.
///
/// Lines are shared out to at most `threads` threads.
pub fn parse(
    text: &[u8],
    delimiter: Delimiter,
    columns: usize,
    wanted: &[usize],
    threads: usize,
) -> Option<Vec<f64>> {
    let count = threads.min(text.len() / PART).max(1);
    let mut parts = Vec::with_capacity(count);
    let mut rest = text;
    for k in (1..count).rev() {
        let share = rest.len() / (k + 1);
        if let Some(length) = rest[share..].iter().position(|&byte| byte == b'\n') {
            parts.push(&rest[..share + length]);
            rest = &rest[share + length + 1..];
        }
    }
    parts.push(rest);
    let mut numbers =
        parallel::map(parts.len(), threads, |k| lines(parts[k], delimiter, columns, wanted)).into_iter();
    let mut all = numbers.next()??;
    for part in numbers {
        all.extend(part?);
    }
    Some(all)
}

/// Numbers of some lines.
fn lines(text: &[u8], delimiter: Delimiter, columns: usize, wanted: &[usize]) -> Option<Vec<f64>> {
    let mut numbers = Vec::with_capacity(text.len() / 8);
    for line in text.split(|&byte| byte == b'\n') {
        let line = line.strip_suffix(b"\r").unwrap_or(line);
        match delimiter {
            Delimiter::Byte(separator) => {
                take(line.split(|&byte| byte == separator), columns, wanted, &mut numbers)?;
            }
            Delimiter::Blanks => {
                let cells = line.split(|&byte| byte == b' ' || byte == b'\t').filter(|cell| !cell.is_empty());
                take(cells, columns, wanted, &mut numbers)?;
            }
        }
    }
    Some(numbers)
}

/// The wanted cells of a line.
fn take<'a>(
    cells: impl Iterator<Item = &'a [u8]>,
    columns: usize,
    wanted: &[usize],
    numbers: &mut Vec<f64>,
) -> Option<()> {
    let (mut count, mut next) = (0, wanted.iter().peekable());
    for cell in cells {
        if next.next_if_eq(&&count).is_some() {
            numbers.push(number(cell)?);
        }
        count += 1;
    }
    (count == columns && next.peek().is_none()).then_some(())
}

/// A finite number as Python writes it; Rust would also take words.
fn number(cell: &[u8]) -> Option<f64> {
    let cell = cell.trim_ascii();
    let plain = cell.iter().all(|byte| matches!(byte, b'0'..=b'9' | b'+' | b'-' | b'.' | b'e' | b'E'));
    let value: f64 = std::str::from_utf8(cell).ok().filter(|_| plain)?.parse().ok()?;
    value.is_finite().then_some(value)
}
