//! [`Grid`]: plots side by side.

use anyhow::{Result, bail};

use super::draw::{Area, SMALL, WIDTH, page, px};
use super::legend::Legend;
use super::plot::{Panel, Plot};

/// Plots in rows. A name of a series has the same colour and marker in all of them.
#[derive(Debug, Clone)]
pub struct Grid {
    /// Plots in a row.
    pub columns: usize,
    /// In the order of reading.
    pub plots: Vec<Plot>,
}

impl Grid {
    /// The plots as SVG, with one legend below all when all have the same series, otherwise one below each.
    ///
    /// # Errors
    /// Without a plot or column, or as [`Plot::svg`].
    pub fn svg(&self) -> Result<String> {
        if self.columns == 0 || self.plots.is_empty() {
            bail!("a grid of {} plots in {} columns", self.plots.len(), self.columns);
        }
        let panels = self.panels()?;
        let common = panels.iter().all(|p| p.series_legend() == panels[0].series_legend());
        let above = panels.iter().map(Panel::above_legend).find(|l| !l.0.is_empty()).unwrap_or_default();
        let shared = if common { Legend([panels[0].series_legend().0, above.0].concat()) } else { Legend::default() };
        let own: Vec<Legend> = panels.iter().map(|p| if common { p.line_legend() } else { p.legend() }).collect();

        let columns = self.columns.min(self.plots.len());
        let rows = self.plots.len().div_ceil(columns);
        let cell = WIDTH / columns as i32;
        let legend_width = cell - px(40.0);
        let plot = px(match columns {
            1 => 400.0,
            2 => 340.0,
            _ => 290.0,
        });
        let below = own.iter().map(|l| l.height(legend_width)).max().unwrap_or(0);
        let high = plot + below + px(10.0);
        let shared_width = WIDTH - px(60.0);
        let shared_height = shared.height(shared_width) + px(8.0);
        page(high * rows as i32 + shared_height, |page: &Area| {
            let (cells, bottom) = page.split_vertically(high * rows as i32);
            for ((panel, legend), area) in panels.iter().zip(&own).zip(cells.split_evenly((rows, columns))) {
                let (x, y) = area.get_pixel_range();
                panel.draw(page, [(x.start, y.start), (x.end, y.start + plot)])?;
                legend.draw(page, (x.start + px(30.0), y.start + plot + px(4.0)), legend_width)?;
            }
            shared.draw(page, (px(40.0), bottom.get_base_pixel().1), shared_width)
        })
    }

    /// Looks count the names in the order in which they first appear; what has no name counts by its place.
    fn panels(&self) -> Result<Vec<Panel<'_>>> {
        let mut names: Vec<&str> = Vec::new();
        for series in self.plots.iter().flat_map(|p| &p.series).filter(|s| !s.name.is_empty()) {
            if !names.contains(&series.name.as_str()) {
                names.push(&series.name);
            }
        }
        let look = |(k, name): (usize, &str)| names.iter().position(|n| *n == name).unwrap_or(k);
        let panel = |p: &'_ Plot| p.series.iter().map(|s| s.name.as_str()).enumerate().map(look).collect();
        self.plots.iter().map(|p| Panel::new(p, panel(p), SMALL)).collect()
    }
}
