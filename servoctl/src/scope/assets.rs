//! What the page is made of: our own files, and uPlot where `cargo xtask web` has fetched it before the build.

/// Path, media type, content.
pub(super) type Asset = (&'static str, &'static str, &'static str);

/// The page; `{{token}}` stands where its token goes.
pub(super) const PAGE: &str = include_str!("page/scope.html");

/// Everything else, by path.
pub(super) const ASSETS: [Asset; 4] = [
    ("/scope.css", "text/css; charset=utf-8", include_str!("page/scope.css")),
    ("/scope.js", "text/javascript; charset=utf-8", include_str!("page/scope.js")),
    ("/uplot.css", "text/css; charset=utf-8", include_str!(concat!(env!("OUT_DIR"), "/uplot.css"))),
    ("/uplot.js", "text/javascript; charset=utf-8", include_str!(concat!(env!("OUT_DIR"), "/uplot.js"))),
];
