//! Draws figures 34 to 54 of the thesis, to look at them: `cargo run -p servoctl --example theory_figures`.
//! The page lands beside the example's binary.

use servoctl::report::Report;
use servoctl::theory::Method;
use servoctl::theory::figures::{DELTAS, KP_RATIOS, Map, curve_plot};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut report = Report::new("Settling in theory", "Figures 34 to 54: friction observer and NIASA, computed.");
    report.section("Without mass");
    for kp_ratio in KP_RATIOS {
        let maps = [Method::Niasa, Method::Observer].map(|method| Map::new(method, kp_ratio, 96, 96));
        let [niasa, observer] = maps;
        let (niasa, observer) = (niasa?, observer?);
        let caption = format!(
            "k_P = {kp_ratio} σ: NIASA {:.0} to {:.0} %, observer {:.0} to {:.0} %, unstable on {:.1} % of the map",
            niasa.extremes_percent().0,
            niasa.extremes_percent().1,
            observer.extremes_percent().0,
            observer.extremes_percent().1,
            100.0 * observer.unstable_share()
        );
        report.figure([niasa.plot(), observer.plot()], caption);
    }
    report.section("With mass");
    for delta in DELTAS {
        report.figure([curve_plot(delta, 0.05)?], format!("Error over time, δ = {delta}"));
    }
    let page = report.render();
    let folder = std::env::current_exe()?.parent().map(std::path::Path::to_path_buf).unwrap_or_default();
    let file = folder.join("theory_figures.html");
    std::fs::write(&file, &page)?;
    println!("{} bytes in {}", page.len(), file.display());
    Ok(())
}
