//! Plain text of data files.

use didim::signal::text::{Delimiter, parse};

#[test]
fn plain_text_gives_the_wanted_columns() {
    let text = b"1,2.5,-3e2\r\n .5 ,x,+7.\n1E-3,,9";
    assert_eq!(
        parse(text, Delimiter::Byte(b','), 3, &[0, 2], 2),
        Some(vec![1.0, -300.0, 0.5, 7.0, 1e-3, 9.0])
    );
    assert_eq!(parse(b"1 \t2\n 3  4 ", Delimiter::Blanks, 2, &[1], 2), Some(vec![2.0, 4.0]));
    assert_eq!(parse(b"0.1", Delimiter::Byte(b','), 1, &[0], 2), Some(vec![0.1]));
}

#[test]
fn anything_else_gives_nothing() {
    let comma = Delimiter::Byte(b',');
    for text in [
        "1,2\n3",
        "1,2\n3,4,5",
        "1,2\n\n3,4",
        "1,inf",
        "1,nan",
        "1,",
        "1,\"2\"",
        "1,2_0",
        "1,1e999",
        "1,0x1",
        "",
    ] {
        assert_eq!(parse(text.as_bytes(), comma, 2, &[1], 2), None, "{text}");
    }
    assert_eq!(parse(b"1,2", comma, 2, &[2], 2), None);
}

#[test]
fn parts_of_a_text_are_shared_out_by_lines() {
    use std::fmt::Write;
    let mut text = String::new();
    for line in 0..60_000 {
        writeln!(text, "{line},{}", f64::from(line).sqrt()).unwrap();
    }
    let text = text.trim_end();
    let one = parse(text.as_bytes(), Delimiter::Byte(b','), 2, &[0, 1], 1);
    assert_eq!(one.as_ref().map(Vec::len), Some(120_000));
    for threads in 2..7 {
        assert_eq!(parse(text.as_bytes(), Delimiter::Byte(b','), 2, &[0, 1], threads), one);
        assert_eq!(
            parse(text.replace("59000,", "59000;").as_bytes(), Delimiter::Byte(b','), 2, &[0], threads),
            None
        );
    }
}
