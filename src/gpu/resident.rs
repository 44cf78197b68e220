//! Which directions have arrived, and which of them answers for each direction of the set.

/// The directions that are resident, and for every direction one that is.
#[derive(Debug)]
pub(super) struct Resident {
    /// Unit vectors, world space.
    axes: Vec<[f32; 3]>,
    arrived: Vec<bool>,
    count: usize,
    /// For each direction itself, if it has arrived, or else the nearest that had when [`refresh`](Self::refresh) ran.
    nearest: Vec<u32>,
}

/// A resident direction or its opposite.
struct Point {
    axis: [f32; 3],
    direction: u32,
}

impl Resident {
    /// None of the directions along `axes`.
    pub(super) fn new(axes: Vec<[f32; 3]>) -> Self {
        let count = axes.len();
        Self { axes, arrived: vec![false; count], count: 0, nearest: vec![0; count] }
    }

    /// How many have arrived.
    pub(super) fn count(&self) -> usize {
        self.count
    }

    /// Whether a direction has arrived.
    pub(super) fn has(&self, direction: u32) -> bool {
        self.arrived.get(direction as usize).copied().unwrap_or(false)
    }

    /// A direction has arrived and answers for itself from now on.
    pub(super) fn insert(&mut self, direction: u32) {
        let at = direction as usize;
        self.count += usize::from(!self.arrived[at]);
        self.arrived[at] = true;
        self.nearest[at] = direction;
    }

    /// Finds the nearest resident direction for all that have not arrived: by the angle between lines, and the lowest
    /// among equals.
    pub(super) fn refresh(&mut self) {
        if self.count == 0 || self.count == self.axes.len() {
            return;
        }
        let mut points: Vec<Point> = Vec::with_capacity(2 * self.count);
        for (direction, (&axis, _)) in
            (0..).zip(self.axes.iter().zip(&self.arrived)).filter(|(_, (_, arrived))| **arrived)
        {
            points.push(Point { axis, direction });
            points.push(Point { axis: axis.map(|c| -c), direction });
        }
        points.sort_by(|a, b| a.axis[1].total_cmp(&b.axis[1]).then(a.direction.cmp(&b.direction)));
        for ((nearest, axis), _) in
            self.nearest.iter_mut().zip(&self.axes).zip(&self.arrived).filter(|(_, arrived)| !**arrived)
        {
            *nearest = nearest_of(&points, axis);
        }
    }

    /// For each direction the one that answers for it.
    pub(super) fn nearest(&self) -> &[u32] {
        &self.nearest
    }
}

/// The direction of the point nearest to `axis`. The points are sorted by y and not empty: from the axis' own y the
/// search goes both ways until y alone is farther than the nearest.
fn nearest_of(points: &[Point], axis: &[f32; 3]) -> u32 {
    let middle = points.partition_point(|point| point.axis[1] < axis[1]);
    let mut best = (f32::INFINITY, u32::MAX);
    let mut visit = |point: &Point| {
        let [x, y, z] = [0, 1, 2].map(|i| point.axis[i] - axis[i]);
        if y * y > best.0 {
            return false;
        }
        let distance = x * x + y * y + z * z;
        if distance < best.0 || (distance == best.0 && point.direction < best.1) {
            best = (distance, point.direction);
        }
        true
    };
    let (mut below, mut above) = (points[..middle].iter().rev(), points[middle..].iter());
    let (mut go_down, mut go_up) = (true, true);
    while go_down || go_up {
        go_down = go_down && below.next().is_some_and(&mut visit);
        go_up = go_up && above.next().is_some_and(&mut visit);
    }
    best.1
}

#[cfg(test)]
mod tests {
    use super::*;
    use manyview_shaders::cases::Random;
    use manyview_shaders::directions::DirectionSet;

    fn axes(set: DirectionSet) -> Vec<[f32; 3]> {
        (0..set.count()).map(|d| set.frame(d)[2].map(|c| c as f32)).collect()
    }

    fn by_brute_force(axes: &[[f32; 3]], arrived: &[u32], direction: u32) -> u32 {
        let at = axes[direction as usize];
        let distance = |&other: &u32| {
            let other = axes[other as usize];
            let squared = |sign: f32| {
                let [x, y, z] = [0, 1, 2].map(|i| sign * other[i] - at[i]);
                x * x + y * y + z * z
            };
            squared(1.0).min(squared(-1.0))
        };
        *arrived.iter().min_by(|a, b| distance(a).total_cmp(&distance(b)).then(a.cmp(b))).unwrap()
    }

    #[test]
    fn the_nearest_resident_direction_answers() {
        let mut random = Random::new(3);
        for set in [DirectionSet::LatLong { thetas: 12, phis: 9 }, DirectionSet::Octahedral { size: 11 }] {
            let axes = axes(set);
            let mut resident = Resident::new(axes.clone());
            let mut arrived = Vec::new();
            while arrived.len() < axes.len() {
                let new = random.below(set.count());
                if !arrived.contains(&new) {
                    arrived.push(new);
                    resident.insert(new);
                    resident.insert(new);
                    assert_eq!(resident.nearest()[new as usize], new, "at once");
                }
                resident.refresh();
                assert_eq!(resident.count(), arrived.len());
                for direction in 0..set.count() {
                    let found = resident.nearest()[direction as usize];
                    if arrived.contains(&direction) {
                        assert_eq!(found, direction);
                    } else {
                        assert_eq!(found, by_brute_force(&axes, &arrived, direction), "{set}: {direction}");
                    }
                }
            }
        }
    }

    #[test]
    fn before_a_refresh_the_old_answers_stand() {
        let axes = axes(DirectionSet::LatLong { thetas: 8, phis: 8 });
        let mut resident = Resident::new(axes);
        resident.insert(40);
        resident.refresh();
        resident.insert(17);
        assert_eq!(resident.nearest()[18], 40);
        resident.refresh();
        assert_eq!(resident.nearest()[18], 17);
    }
}
