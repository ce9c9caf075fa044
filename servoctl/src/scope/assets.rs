//! The page's files, as they are in this program.

/// A file and its media type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Asset {
    /// Path of the request.
    pub path: &'static str,
    /// Its `Content-Type`.
    pub media_type: &'static str,
    /// What is in it.
    pub text: &'static str,
}

const JS: &str = "text/javascript; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";

macro_rules! ours {
    ($path:literal, $media_type:expr, $file:literal) => {
        Asset { path: $path, media_type: $media_type, text: include_str!(concat!("../../web/", $file)) }
    };
}

macro_rules! bundled {
    ($path:literal, $media_type:expr, $file:literal) => {
        Asset { path: $path, media_type: $media_type, text: include_str!(concat!(env!("OUT_DIR"), "/", $file)) }
    };
}

/// Every file that is served.
pub const ASSETS: &[Asset] = &[
    ours!("/", "text/html; charset=utf-8", "index.html"),
    ours!("/icon.svg", "image/svg+xml", "icon.svg"),
    ours!("/style.css", CSS, "style.css"),
    ours!("/page.js", JS, "page.js"),
    ours!("/connection.js", JS, "connection.js"),
    ours!("/controls.js", JS, "controls.js"),
    ours!("/traces.js", JS, "traces.js"),
    ours!("/trigger.js", JS, "trigger.js"),
    ours!("/parameters.js", JS, "parameters.js"),
    ours!("/settling.js", JS, "settling.js"),
    ours!("/units.js", JS, "units.js"),
    ours!("/csv.js", JS, "csv.js"),
    bundled!("/uPlot.esm.js", JS, "uPlot.esm.js"),
    bundled!("/uPlot.min.css", CSS, "uPlot.min.css"),
];

/// Whether the plotting library was there when this program was built.
///
/// # Errors
/// What to type.
pub fn complete() -> anyhow::Result<()> {
    all_there(ASSETS)
}

fn all_there(assets: &[Asset]) -> anyhow::Result<()> {
    if assets.iter().all(|asset| !asset.text.is_empty()) {
        return Ok(());
    }
    anyhow::bail!(
        "this servoctl was built without the page's plotting library\n  in the workspace, `cargo xtask scope` fetches it; then build again"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A module that the page imports and nobody serves would only be noticed in a browser.
    #[test]
    fn every_file_that_a_file_names_is_served() {
        for asset in ASSETS.iter().filter(|asset| !asset.path.contains("uPlot")) {
            for quote in ["from \"./", "src=\"/", "href=\"/"] {
                for rest in asset.text.split(quote).skip(1) {
                    let named = format!("/{}", rest.split('"').next().unwrap_or_default());
                    assert!(ASSETS.iter().any(|asset| asset.path == named), "{} names {named}", asset.path);
                }
            }
        }
    }

    /// As in a clone that has no npm yet: everything builds, and `servoctl scope` says what to type.
    #[test]
    fn without_the_plotting_library_the_page_says_what_to_type() {
        let missing = [ASSETS[0], Asset { path: "/uPlot.esm.js", media_type: JS, text: "" }];
        let words = all_there(&missing).unwrap_err().to_string();
        assert!(
            words.contains("without the page's plotting library") && words.contains("`cargo xtask scope`"),
            "{words}"
        );
        assert!(all_there(&missing[..1]).is_ok());
    }

    #[test]
    fn no_file_names_another_server() {
        for asset in ASSETS.iter().filter(|asset| !asset.path.contains("uPlot")) {
            for scheme in ["http://", "https://", "\"//"] {
                let named = asset.text.split(scheme).nth(1).map(|rest| rest.split('"').next().unwrap_or_default());
                // A name space is no address.
                assert!(named.is_none_or(|named| named.starts_with("www.w3.org")), "{} names {named:?}", asset.path);
            }
        }
    }
}
