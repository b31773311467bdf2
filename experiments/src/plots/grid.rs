//! [`Grid`]: plots side by side.

use anyhow::{Result, bail};

use super::draw::{Sizes, WIDTH, page, px, side_by_side};
use super::legend::Legend;
use super::plot::{Layout, Panel, Plot, Series};

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
        let columns = self.columns.min(self.plots.len());
        let panels = self.panels(side_by_side(columns))?;
        let common = panels.iter().all(|p| p.series_legend() == panels[0].series_legend());
        let above = panels.iter().map(Panel::above_legend).find(|l| !l.0.is_empty()).unwrap_or_default();
        let shared = if common { Legend([panels[0].series_legend().0, above.0].concat()) } else { Legend::default() };
        let own: Vec<Legend> = panels.iter().map(|p| if common { p.line_legend() } else { p.legend() }).collect();

        let rows = self.plots.len().div_ceil(columns);
        let cell = WIDTH / columns as i32;
        let layouts: Vec<Layout> = panels.iter().map(|p| p.layout(cell)).collect();
        // The same in all, so that the frames of a row are level.
        let header = layouts.iter().map(|l| l.header).max().unwrap_or(0);
        let plot = header + panels[0].high();
        let legend_width = cell - px(40.0);
        let high = plot + own.iter().map(|l| l.height(legend_width)).max().unwrap_or(0) + px(10.0);
        let shared_width = WIDTH - px(60.0);
        page(high * rows as i32 + shared.height(shared_width) + px(8.0), |page| {
            let (cells, bottom) = page.split_vertically(high * rows as i32);
            let cells = cells.split_evenly((rows, columns));
            for (((panel, layout), legend), area) in panels.iter().zip(&layouts).zip(&own).zip(cells) {
                let (x, y) = area.get_base_pixel();
                panel.draw(page, layout, (x, y), header)?;
                legend.draw(page, (x + px(30.0), y + plot + px(4.0)), legend_width)?;
            }
            shared.draw(page, (px(40.0), bottom.get_base_pixel().1), shared_width)
        })
    }

    /// Looks count the names in the order in which they first appear; what has no name counts by its place.
    fn panels(&self, sizes: Sizes) -> Result<Vec<Panel<'_>>> {
        let mut names: Vec<&str> = Vec::new();
        for series in self.plots.iter().flat_map(|p| &p.series).filter(|s| !s.name.is_empty()) {
            if !names.contains(&series.name.as_str()) {
                names.push(&series.name);
            }
        }
        let look = |(k, s): (usize, &Series)| names.iter().position(|n| *n == s.name).unwrap_or(k);
        self.plots.iter().map(|p| Panel::new(p, p.series.iter().enumerate().map(look).collect(), sizes)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plots::{Axis, Point};

    fn plot(title: &str, names: &[&str]) -> Plot {
        let points = || [1.0, 2.0].map(|x| Point { x, y: x, spread: None }).to_vec();
        let series = names.iter().map(|n| Series::line(n, points())).collect();
        Plot::new(title, Axis::linear("x"), Axis::log("y")).series(series)
    }

    #[test]
    fn one_legend_for_all_when_they_are_alike() {
        let legends = |plots: Vec<Plot>| Grid { columns: 2, plots }.svg().unwrap().matches("blue line\n").count();
        let names = ["blue line", "red line"];
        assert_eq!(legends(vec![plot("one", &names), plot("two", &names), plot("three", &names)]), 1);
        assert_eq!(legends(vec![plot("one", &names), plot("two", &names), plot("three", &names[..1])]), 3);
    }

    #[test]
    fn a_name_looks_the_same_everywhere() {
        let svg = Grid { columns: 2, plots: vec![plot("one", &["a", "b"]), plot("two", &["b"])] }.svg().unwrap();
        // Markers of "b" are the only squares: two in each plot and one in each legend.
        assert_eq!(svg.matches("<polygon").count(), 6);
        assert!(svg.contains("one") && svg.contains("two"));
    }

    #[test]
    fn an_empty_grid_is_an_error() {
        assert!(Grid { columns: 2, plots: vec![] }.svg().is_err());
        assert!(Grid { columns: 0, plots: vec![plot("one", &["a"])] }.svg().is_err());
        assert!(Grid { columns: 1, plots: vec![plot("one", &[])] }.svg().is_err());
    }
}
