//! A chart as inline SVG, with reduced curves and placed labels.
//!
//! Knows axes, marks and boxes in the picture's units, not their meaning. Colours are those of a light page;
//! `style.css` maps each to its dark counterpart. A curve is reduced to about as many points as a screen has columns;
//! the minimum and maximum of each column are kept, so no peak is lost.

use std::ops::Range;

use plotters::coord::Shift;
use plotters::coord::ranged1d::{AsRangedCoord, ValueFormatter};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

/// The content of a chart.
pub struct Chart {
    /// Horizontal axis.
    pub x: Axis,
    /// Vertical axis.
    pub y: Axis,
    /// The marks, in drawing order.
    pub marks: Vec<Mark>,
}

/// One axis.
pub struct Axis {
    /// Title with unit.
    pub title: String,
    /// Linear or logarithmic.
    pub scale: Scale,
    /// Lower end.
    pub from: f64,
    /// Upper end.
    pub to: f64,
}

/// Mapping of values along an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// Equal steps for equal differences.
    Linear,
    /// Between two powers of ten; smaller values are drawn at the lower end.
    Log,
}

/// A mark on a chart, in values of its axes.
pub enum Mark {
    /// A line through points.
    Line {
        /// Its colour.
        color: RGBColor,
        /// Its width, in the picture's units.
        width: u32,
        /// Lengths of dash and gap, in the picture's units; `None` for a whole line.
        dash: Option<(u32, u32)>,
        /// Its points.
        points: Vec<(f64, f64)>,
    },
    /// A thin vertical line with a label at its foot.
    Vertical {
        /// Its place on the horizontal axis.
        at: f64,
        /// Its label.
        label: String,
    },
    /// A disc with a label.
    Dot {
        /// Its colour.
        color: RGBColor,
        /// Its radius, in the picture's units.
        radius: i32,
        /// Its centre.
        at: (f64, f64),
        /// Its label.
        label: String,
    },
}

/// Colour of text and axes.
pub(super) const INK: RGBColor = RGBColor(55, 65, 81);
/// Colour of the grid.
const GRID: RGBColor = RGBColor(229, 231, 235);

/// Size in the picture's units, twice the displayed size, since marks lie on whole units.
pub const SIZE: (u32, u32) = (1_680, 680);
const LETTERS: i32 = 32;
/// Height of the text below the chart.
const BELOW: u32 = 96;
/// Size of the picture above that text.
const ABOVE_WORDS: (i32, i32) = (SIZE.0 as i32, (SIZE.1 - BELOW) as i32);

impl Axis {
    /// Powers of ten around all values, at least one decade.
    pub fn log(title: &str, values: impl Iterator<Item = f64>) -> Self {
        let positive = values.filter(|value| *value > 0.0 && value.is_finite());
        let (least, most) = positive.fold((f64::MAX, 0.0_f64), |(least, most), value| {
            (least.min(value), most.max(value))
        });
        let (least, most) = if most > 0.0 {
            (least, most)
        } else {
            (1.0, 10.0)
        };
        let low = least.log10().floor();
        let high = most.log10().ceil().max(low + 1.0);
        Self {
            title: title.to_owned(),
            scale: Scale::Log,
            from: 10_f64.powf(low),
            to: 10_f64.powf(high),
        }
    }

    /// The axis from `from` to the largest value.
    pub fn linear(title: &str, from: f64, values: impl Iterator<Item = f64>) -> Self {
        let most = values.fold(from, f64::max);
        Self {
            title: title.to_owned(),
            scale: Scale::Linear,
            from,
            to: if most > from { most } else { from + 1.0 },
        }
    }

    /// The value, clamped to the axis.
    fn clamp(&self, value: f64) -> f64 {
        value.clamp(self.from, self.to)
    }

    /// Slightly more than the axis, so that a power of ten keeps its label despite rounding.
    fn range(&self) -> Range<f64> {
        match self.scale {
            Scale::Linear => self.from..self.to,
            Scale::Log => self.from * (1.0 - 1e-9)..self.to * (1.0 + 1e-9),
        }
    }

    /// Position of a value along the axis, from 0 to 1.
    fn share(&self, value: f64) -> f64 {
        let value = self.clamp(value);
        match self.scale {
            Scale::Linear => (value - self.from) / (self.to - self.from),
            Scale::Log => (value / self.from).ln() / (self.to / self.from).ln(),
        }
    }

    /// Number of labels: one per power of ten, or about six.
    fn labels(&self) -> usize {
        match self.scale {
            Scale::Linear => 6,
            Scale::Log => (self.to / self.from).log10().round() as usize + 1,
        }
    }
}

impl Chart {
    /// The chart as an `svg` element.
    pub fn svg(&self) -> String {
        let mut text = String::new();
        let root = SVGBackend::with_string(&mut text, SIZE).into_drawing_area();
        let (x, y) = (self.x.range(), self.y.range());
        let painted = match (self.x.scale, self.y.scale) {
            (Scale::Linear, Scale::Linear) => self.paint(&root, x, y),
            (Scale::Linear, Scale::Log) => self.paint(&root, x, y.log_scale()),
            (Scale::Log, Scale::Linear) => self.paint(&root, x.log_scale(), y),
            (Scale::Log, Scale::Log) => self.paint(&root, x.log_scale(), y.log_scale()),
        };
        painted.expect("drawing to a string succeeds");
        drop(root);
        text
    }

    fn paint<'t, X, Y>(&self, root: &Area<'t>, x: X, y: Y) -> Result<(), PlotError<'t>>
    where
        X: AsRangedCoord<Value = f64>,
        Y: AsRangedCoord<Value = f64>,
        X::CoordDescType: ValueFormatter<f64>,
        Y::CoordDescType: ValueFormatter<f64>,
    {
        let mut chart = ChartBuilder::on(root)
            .margin(12)
            .margin_right(60)
            .x_label_area_size(BELOW)
            .y_label_area_size(150)
            .build_cartesian_2d(x, y)?;
        let words = ("sans-serif", LETTERS).into_font().color(&INK);
        chart
            .configure_mesh()
            .axis_style(INK.stroke_width(2))
            .bold_line_style(GRID.stroke_width(2))
            .light_line_style(TRANSPARENT)
            .label_style(words.clone())
            .axis_desc_style(words.clone())
            .x_desc(&self.x.title)
            .y_desc(&self.y.title)
            .x_labels(self.x.labels())
            .y_labels(self.y.labels())
            .x_label_formatter(&|value| plain(*value))
            .y_label_formatter(&|value| plain(*value))
            .draw()?;
        let within = |(x, y): (f64, f64)| (self.x.clamp(x), self.y.clamp(y));
        let mut labels = Labels::new(ABOVE_WORDS, (LETTERS * 3 / 5, LETTERS));
        let mut dots = Vec::new();
        for mark in &self.marks {
            match mark {
                Mark::Line {
                    color,
                    width,
                    dash,
                    points,
                } => {
                    let points = points.iter().copied().map(within);
                    labels.avoid_line(points.clone().map(|point| chart.backend_coord(&point)));
                    draw_line(&mut chart, points, color.stroke_width(*width), *dash)?;
                }
                Mark::Vertical { at, label } => {
                    let ends = [(*at, self.y.from), (*at, self.y.to)].map(within);
                    chart.draw_series(LineSeries::new(ends, INK.stroke_width(2)))?;
                    let (side, aside) = side_with_space(self.x.share(*at));
                    let word = words.clone().pos(Pos::new(side, VPos::Bottom));
                    let text = Text::new(label.clone(), (aside, -12), word);
                    chart.draw_series([EmptyElement::at(ends[0]) + text])?;
                }
                Mark::Dot {
                    color,
                    radius,
                    at,
                    label,
                } => {
                    let at = chart.backend_coord(&within(*at));
                    labels.avoid(at, *radius);
                    dots.push((at, *radius, *color, label));
                }
            }
        }
        draw_dots(root, &mut labels, &dots, &words)?;
        root.present()
    }
}

fn draw_line<'t, X: Ranged<ValueType = f64>, Y: Ranged<ValueType = f64>>(
    chart: &mut ChartContext<'_, SVGBackend<'t>, Cartesian2d<X, Y>>,
    points: impl Iterator<Item = (f64, f64)> + Clone,
    style: ShapeStyle,
    dash: Option<(u32, u32)>,
) -> Result<(), PlotError<'t>> {
    match dash {
        None => chart.draw_series(LineSeries::new(points, style))?,
        Some((dash, gap)) => chart.draw_series(DashedLineSeries::new(points, dash, gap, style))?,
    };
    Ok(())
}

/// Side of a vertical line with more space, and the offset of its label.
const fn side_with_space(share: f64) -> (HPos, i32) {
    if share > 0.5 {
        (HPos::Right, -12)
    } else {
        (HPos::Left, 12)
    }
}

/// Positions, radii, colours and labels of dots.
type Dots<'m> = Vec<((i32, i32), i32, RGBColor, &'m String)>;

/// Draws the dots, and writes the labels that fit.
fn draw_dots<'t>(
    root: &Area<'t>,
    labels: &mut Labels,
    dots: &Dots<'_>,
    words: &TextStyle<'_>,
) -> Result<(), PlotError<'t>> {
    for (at, radius, color, _) in dots {
        root.draw(&Circle::new(*at, *radius, color.filled()))?;
    }
    for (at, radius, _, label) in dots.iter().filter(|(.., label)| !label.is_empty()) {
        if let Some(corner) = labels.place(*at, *radius, label) {
            let word = words.clone().pos(Pos::new(HPos::Left, VPos::Top));
            root.draw(&Text::new(String::clone(label), corner, word))?;
        }
    }
    Ok(())
}

/// A number with up to six decimals, without trailing zeros.
pub(super) fn plain(value: f64) -> String {
    let text = format!("{value:.6}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

type Area<'t> = DrawingArea<SVGBackend<'t>, Shift>;
type PlotError<'t> = DrawingAreaErrorKind<<SVGBackend<'t> as DrawingBackend>::ErrorType>;

/// A box: left, top, right, bottom.
type Corners = [i32; 4];

/// Boxes already occupied, and the sizes of picture and letters.
#[derive(Debug)]
struct Labels {
    size: (i32, i32),
    letter: (i32, i32),
    taken: Vec<Corners>,
}

impl Labels {
    /// An empty picture of a size, with letters of a width and height.
    pub(super) const fn new(size: (i32, i32), letter: (i32, i32)) -> Self {
        Self {
            size,
            letter,
            taken: Vec::new(),
        }
    }

    /// Keeps labels off a dot.
    fn avoid(&mut self, (x, y): (i32, i32), radius: i32) {
        let taken = [x - radius, y - radius, x + radius, y + radius];
        self.taken.push(taken);
    }

    /// Keeps labels off a polyline.
    fn avoid_line(&mut self, points: impl Iterator<Item = (i32, i32)>) {
        let mut last = None;
        for to in points {
            let from = last.replace(to).unwrap_or(to);
            let (x, y) = (to.0 - from.0, to.1 - from.1);
            let steps = (x.abs().max(y.abs()) / LINE_STEP).max(1);
            for step in 0..=steps {
                self.avoid((from.0 + x * step / steps, from.1 + y * step / steps), 2);
            }
        }
    }

    /// Upper left corner of a label beside a dot: right or left, above or below; `None` if all of these are occupied.
    pub(super) fn place(
        &mut self,
        (x, y): (i32, i32),
        radius: i32,
        word: &str,
    ) -> Option<(i32, i32)> {
        let (width, height) = (word.chars().count() as i32 * self.letter.0, self.letter.1);
        let gap = radius + 4;
        let corners = [
            (x + gap, y - height / 2),
            (x - gap - width, y - height / 2),
            (x - width / 2, y - gap - height),
            (x - width / 2, y + gap),
            (x + gap, y - height),
            (x - gap - width, y),
        ];
        let fits = |(left, top): &(i32, i32)| {
            let own = [*left, *top, left + width, top + height];
            let inside =
                own[0] >= 0 && own[1] >= 0 && own[2] <= self.size.0 && own[3] <= self.size.1;
            inside && !self.taken.iter().any(|other| overlap(&own, other))
        };
        let corner = corners.into_iter().find(fits)?;
        self.taken
            .push([corner.0, corner.1, corner.0 + width, corner.1 + height]);
        Some(corner)
    }
}

/// Spacing of the points that keep labels off a line.
const LINE_STEP: i32 = 6;

fn overlap(a: &Corners, b: &Corners) -> bool {
    a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3]
}

/// Largest number of points of a curve.
const POINTS_MAX: usize = 900;

/// A short curve unchanged; otherwise the lowest and highest point of each column, in order.
pub(super) fn decimate(points: Vec<(f64, f64)>) -> Vec<(f64, f64)> {
    if points.len() <= POINTS_MAX {
        return points;
    }
    let columns = POINTS_MAX / 2;
    let mut kept = Vec::with_capacity(POINTS_MAX);
    for column in 0..columns {
        let (from, to) = (
            column * points.len() / columns,
            (column + 1) * points.len() / columns,
        );
        let part = &points[from..to];
        let by_height = |a: &&(f64, f64), b: &&(f64, f64)| a.1.total_cmp(&b.1);
        let ends = part
            .iter()
            .min_by(by_height)
            .zip(part.iter().max_by(by_height));
        if let Some((low, high)) = ends {
            let (first, second) = if low.0 <= high.0 {
                (low, high)
            } else {
                (high, low)
            };
            kept.push(*first);
            if first != second {
                kept.push(*second);
            }
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_log_axis_ends_at_powers_of_ten() {
        let axis = Axis::log("x", [0.0, 0.03, 700.0].into_iter());
        assert!((axis.from - 0.01).abs() < 1e-12 && (axis.to - 1_000.0).abs() < 1e-9);
        assert_eq!(axis.labels(), 6);
        let none = Axis::log("x", std::iter::empty());
        assert_eq!((none.from, none.to), (1.0, 10.0));
        assert!((axis.share(0.1) - 0.2).abs() < 1e-12);
    }

    #[test]
    fn a_plain_number_has_no_trailing_zeros() {
        assert_eq!(
            [0.001, 50.0, 0.1, 100.0 / 3.0].map(plain),
            ["0.001", "50", "0.1", "33.333333"]
        );
    }

    #[test]
    fn labels_overlap_neither_each_other_nor_dots() {
        let mut labels = Labels::new((1_000, 500), (10, 20));
        let dots = [(500, 250), (500, 250), (520, 250), (5, 5), (995, 495)];
        for dot in dots {
            labels.avoid(dot, 6);
        }
        for dot in dots {
            labels.place(dot, 6, "1,000");
        }
        let taken = &labels.taken;
        for (place, one) in taken.iter().enumerate().skip(dots.len()) {
            let others = taken
                .iter()
                .enumerate()
                .filter(|(other, _)| *other != place);
            assert!(others.clone().count() > 0);
            assert!(others.into_iter().all(|(_, other)| !overlap(one, other)));
            assert!(one[0] >= 0 && one[1] >= 0 && one[2] <= 1_000 && one[3] <= 500);
        }
        assert!(taken.len() > dots.len() + 2);
    }

    #[test]
    fn a_label_without_space_is_omitted() {
        let mut labels = Labels::new((20, 20), (10, 20));
        assert_eq!(labels.place((10, 10), 4, "words"), None);
    }

    #[test]
    fn decimation_keeps_every_peak() {
        let flat = (0..100_000).map(|x| (f64::from(x), f64::from(x % 3)));
        let mut points: Vec<_> = flat.collect();
        points[54_321].1 = 99.0;
        points[12_345].1 = -99.0;
        let kept = decimate(points.clone());
        assert!(kept.len() <= POINTS_MAX);
        assert!(kept.contains(&points[54_321]) && kept.contains(&points[12_345]));
        assert!(kept.windows(2).all(|pair| pair[0].0 < pair[1].0));
    }

    #[test]
    fn a_short_curve_is_unchanged() {
        let points = vec![(0.0, 1.0), (1.0, 0.0)];
        assert_eq!(decimate(points.clone()), points);
    }
}
