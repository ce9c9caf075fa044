use super::*;
use roxmltree::{Document, Node};

/// Texts of all `<text>` elements.
fn texts(svg: &str) -> Vec<String> {
    let document = Document::parse(svg).unwrap();
    document
        .descendants()
        .filter(|n| n.has_tag_name(("http://www.w3.org/2000/svg", "text")))
        .map(|n| n.text().unwrap_or("").to_owned())
        .collect()
}

fn with_class<'a>(document: &'a Document, class: &str) -> Vec<Node<'a, 'a>> {
    document.descendants().filter(|n| n.attribute("class").is_some_and(|c| c.split(' ').any(|c| c == class))).collect()
}

/// Every kind of mark, band and axis in one.
fn everything() -> Plot {
    Plot::new(
        "all <of> \"it\" & more",
        Axis::log("frequency / Hz"),
        Axis::linear("error & force / nm").range(-100.0, 100.0),
    )
    .series(
        Series::new("a <b>", 0)
            .line((1..2000).map(|i| (f64::from(i), 150.0 * (f64::from(i) * 0.01).sin())))
            .dots([(10.0, 50.0), (f64::NAN, 1.0), (10.0, 1e9), (-1.0, 0.0)])
            .error_bar(100.0, 20.0, 10.0),
    )
    .series(Series::new("second", 7).line([(1.0, f64::NAN), (2.0, f64::INFINITY)]))
    .band(Band::y("±10 nm", -10.0, 10.0))
    .band(Band::x("crossover", 100.0, 100.0))
    .band(Band::y("elsewhere", 500.0, 600.0))
}

#[test]
fn a_plot_is_well_formed_and_escapes_what_it_is_given() {
    let svg = everything().svg();
    let document = Document::parse(&svg).unwrap();
    let root = document.root_element();
    assert_eq!(root.attribute("viewBox"), Some("0 0 480 320"));
    assert_eq!(root.attribute("aria-label"), Some("all <of> \"it\" & more"));
    assert_eq!(root.attribute("width"), None, "the page decides how wide it is");
    let texts = texts(&svg);
    for expected in ["error & force / nm", "frequency / Hz", "a <b>", "second", "±10 nm", "−100", "1000"] {
        assert!(texts.iter().any(|t| t == expected), "{expected} missing in {texts:?}");
    }
    assert!(!svg.contains("NaN") && !svg.contains("inf"));
}

#[test]
fn a_file_of_its_own_carries_size_and_style() {
    let file = everything().svg_file();
    let document = Document::parse(&file).unwrap();
    assert_eq!(document.root_element().attribute("width"), Some("480"));
    assert!(document.descendants().any(|n| n.tag_name().name() == "style" && n.text().unwrap().contains("--c0")));
}

#[test]
fn the_same_plot_is_the_same_bytes() {
    assert_eq!(everything().svg(), everything().svg());
}

#[test]
fn control_characters_do_not_break_the_document() {
    let svg = Plot::new("\u{0}\u{8}", Axis::linear("\u{1f}\u{ffff}"), Axis::linear("ok")).svg();
    assert!(Document::parse(&svg).is_ok());
}

#[test]
fn what_lies_outside_the_range_is_not_drawn() {
    let plot = Plot::new("", Axis::linear("x").range(0.0, 1.0), Axis::linear("y").range(0.0, 1.0)).series(
        Series::new("s", 0).line([(0.0, 5.0), (1.0, 5.0)]).dots([(2.0, 0.5), (0.5, 0.5)]).error_bar(0.5, -3.0, 1.0),
    );
    let svg = plot.svg();
    let document = Document::parse(&svg).unwrap();
    assert!(with_class(&document, "lines").is_empty());
    assert_eq!(with_class(&document, "faint").len(), 1);
    let bars = with_class(&document, "bar");
    assert!(bars.is_empty(), "{}", svg);
}

#[test]
fn unusable_ranges_and_no_data_still_draw_axes() {
    for (low, high) in [(1.0, 1.0), (2.0, 1.0), (f64::NAN, 1.0), (0.0, f64::INFINITY)] {
        let svg = Plot::new("", Axis::linear("x").range(low, high), Axis::log("y").range(low, high)).svg();
        let texts = texts(&svg);
        assert!(texts.contains(&"0.2".to_owned()) && texts.contains(&"10".to_owned()), "{low} {high}: {texts:?}");
    }
}

#[test]
fn the_range_follows_the_data_including_error_bars() {
    let plot =
        Plot::new("", Axis::linear("x"), Axis::linear("y")).series(Series::new("s", 0).error_bar(1.0, 50.0, 50.0));
    let texts = texts(&plot.svg());
    assert!(texts.contains(&"0".to_owned()) && texts.contains(&"100".to_owned()), "{texts:?}");
}

#[test]
fn a_legend_that_is_too_wide_goes_on_in_the_next_row() {
    let plot = (0..12).fold(Plot::new("", Axis::linear("x"), Axis::linear("y")), |plot, i| {
        plot.series(Series::new(format!("a rather long name {i}"), i))
    });
    let svg = plot.svg();
    let document = Document::parse(&svg).unwrap();
    let entries: Vec<(f64, f64, usize)> = document
        .descendants()
        .filter(|n| n.text().is_some_and(|t| t.starts_with("a rather")) && n.is_element())
        .map(|n| {
            let number = |name| n.attribute(name).unwrap().parse().unwrap();
            (number("x"), number("y"), n.text().unwrap().chars().count())
        })
        .collect();
    assert_eq!(entries.len(), 12);
    let frame_top: f64 = with_class(&document, "frame")[0].attribute("y").unwrap().parse().unwrap();
    for (x, y, chars) in entries {
        assert!(x + chars as f64 * 7.0 <= WIDTH && y < frame_top);
    }
}

#[test]
fn ten_noisy_traces_of_sixteen_thousand_samples_stay_small() {
    let mut noise = 1u32;
    let mut random = || {
        noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(noise >> 8) / f64::from(1 << 24) - 0.5
    };
    let series = (0..10).fold(Series::new("pid", 0), |series, _| {
        series.line(
            (0..16_000)
                .map(|i| (f64::from(i) / 8.0, 500.0 * (-f64::from(i) / 800.0).exp() + 3.0 * random()))
                .collect::<Vec<_>>(),
        )
    });
    let plot = Plot::new("", Axis::linear("t / ms"), Axis::linear("e / nm").range(-100.0, 100.0)).series(series);
    let bytes = plot.svg().len();
    assert!(bytes < 10 * 6_000, "{bytes} bytes");
}

fn heat(values: Vec<f64>, columns: usize) -> Plot {
    let heat = Heat {
        x: (0.0, 1.0),
        y: (0.0, 1.0),
        columns,
        values,
        levels: vec![-10.0, 0.0, 10.0],
        missing: "unstable".into(),
    };
    Plot::new("map", Axis::linear("x").range(0.0, 1.0), Axis::linear("y").range(0.0, 1.0))
        .series(Series::new("change / %", 0).heat(heat))
}

#[test]
fn a_heat_map_has_one_path_per_class_and_joins_neighbours_in_a_row() {
    let svg = heat(vec![-50.0, -50.0, -5.0, 5.0, 50.0, f64::NAN, 50.0, 50.0], 4).svg();
    let document = Document::parse(&svg).unwrap();
    let cells = |class: &str| {
        let paths: Vec<_> = with_class(&document, class).into_iter().filter(|n| n.has_tag_name("path")).collect();
        paths[0].attribute("d").unwrap().matches('M').count()
    };
    // Below −10 %, −10 to 0, 0 to 10, above 10, no value; the lower row holds the first four values.
    assert_eq!(["b1", "b0", "a0", "a1", "none"].map(cells), [1, 1, 1, 2, 1]);
}

#[test]
fn a_heat_map_explains_its_colours_above_the_frame() {
    let svg = heat(vec![1.0], 1).svg();
    let texts = texts(&svg);
    for expected in ["change / %", "unstable", "−10", "10"] {
        assert!(texts.iter().any(|t| t == expected), "{expected} missing in {texts:?}");
    }
    let document = Document::parse(&svg).unwrap();
    let frame_top: f64 = with_class(&document, "frame")[0].attribute("y").unwrap().parse().unwrap();
    for label in document.descendants().filter(|n| n.is_element() && matches!(n.text(), Some("−10" | "unstable"))) {
        assert!(label.attribute("y").unwrap().parse::<f64>().unwrap() < frame_top);
    }
}

#[test]
fn a_heat_map_with_no_cells_or_a_ragged_end_draws_what_there_is() {
    for (values, columns) in [(vec![], 3), (vec![1.0], 0), (vec![1.0; 7], 3)] {
        let svg = heat(values, columns).svg();
        assert!(Document::parse(&svg).is_ok() && !svg.contains("NaN") && !svg.contains("inf"), "{svg}");
    }
}

#[test]
fn a_symbol_in_a_label_has_its_index_below_the_line() {
    let svg = Plot::new("", Axis::linear("F_C / N"), Axis::linear("force_n, F_i^sat")).svg();
    assert!(svg.contains(r#">F<tspan dy="3" font-size="75%">C</tspan><tspan dy="-3"> / N</tspan></text>"#), "{svg}");
    let raised =
        r#"force_n, F<tspan dy="3" font-size="75%">i</tspan><tspan dy="-8" font-size="75%">sat</tspan></text>"#;
    assert!(svg.contains(raised), "{svg}");
}
