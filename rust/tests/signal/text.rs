//! Plain text of data files.

use didim::signal::text::{Delimiter, parse};

#[test]
fn plain_text_gives_the_wanted_columns() {
    let text = b"1,2.5,-3e2\r\n .5 ,x,+7.\n1E-3,,9";
    assert_eq!(parse(text, Delimiter::Byte(b','), 3, &[0, 2]), Some(vec![1.0, -300.0, 0.5, 7.0, 1e-3, 9.0]));
    assert_eq!(parse(b"1 \t2\n 3  4 ", Delimiter::Blanks, 2, &[1]), Some(vec![2.0, 4.0]));
    assert_eq!(parse(b"0.1", Delimiter::Byte(b','), 1, &[0]), Some(vec![0.1]));
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
        assert_eq!(parse(text.as_bytes(), comma, 2, &[1]), None, "{text}");
    }
    assert_eq!(parse(b"1,2", comma, 2, &[2]), None);
}
