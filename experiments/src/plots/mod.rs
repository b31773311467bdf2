//! Plots as SVG text that can stand inline in an HTML page, and the laws fitted to what they show.
//!
//! [`Plot`] has points and laws over two axes; [`Grid`] several plots side by side; [`StackedBars`] and [`GroupedBars`] compare named
//! things. Each has `svg()`. [`PowerLaw`] and [`LinearFit`] are fitted to points (x, y).
//!
//! Every picture scales with the page by its `viewBox`, made to be read 1100 pixels wide, and has no identifiers, so that any number
//! of them stand in one page. The same input gives the same text.

mod axis;
mod bars;
mod canvas;
mod fit;
mod plot;

pub use axis::Axis;
pub use bars::{Bar, GroupedBars, StackedBars};
pub use fit::{LinearFit, PowerLaw};
pub use plot::{Grid, Mark, Plot, Point, Series};
