//! Writes an image of the present schema, every value unlike its default, and the same values as text: what
//! `tests/golden_image.rs` keeps of each schema. To be run, with the two files as arguments, before the schema number is raised.

use std::env::args;
use std::fmt::Write;
use std::fs::write;

use servo_core::image;
use servo_core::parameters::{Settings, TABLE};

fn main() -> std::io::Result<()> {
    let (Some(image_file), Some(text_file)) = (args().nth(1), args().nth(2)) else {
        return Err(std::io::Error::other("which two files?"));
    };
    let mut settings = Settings::default();
    let mut text = String::new();
    for row in TABLE {
        let candidates = [1.0625 * row.default, 0.9375 * row.default, 1.0, row.min, row.max];
        for value in candidates.into_iter().filter(|value| *value != row.default) {
            let mut changed = settings;
            if row.set(&mut changed, value).is_ok() && changed.validate().is_ok() {
                settings = changed;
                break;
            }
        }
        let _ = writeln!(text, "{:#06x} {} {:?}", row.id, row.name, row.get(&settings));
    }
    let (words, seal) = image::encode(&settings, 3);
    write(image_file, [words.concat(), seal.to_vec(), seal.to_vec()].concat())?;
    write(text_file, text)
}
