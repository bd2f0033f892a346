//! Places labels beside dots without overlaps.
//!
//! Knows boxes in the picture's units, not their content.

/// A box: left, top, right, bottom.
pub(super) type Corners = [i32; 4];

/// Boxes already occupied, and the sizes of picture and letters.
#[derive(Debug)]
pub(super) struct Labels {
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
    pub(super) fn avoid(&mut self, (x, y): (i32, i32), radius: i32) {
        let taken = [x - radius, y - radius, x + radius, y + radius];
        self.taken.push(taken);
    }

    /// Keeps labels off a polyline.
    pub(super) fn avoid_line(&mut self, points: impl Iterator<Item = (i32, i32)>) {
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

#[cfg(test)]
mod tests {
    use super::*;

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
}
