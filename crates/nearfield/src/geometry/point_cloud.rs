//! Point clouds: an f64 origin plus f32 offsets, so that map coordinates keep their millimetres.

use glam::{DVec3, Vec3};

use super::{Aabb, validate};
use crate::{Error, Result};

/// Points with optional normals, colours and named attributes.
///
/// World coordinates are `origin + points[i]`. The origin is whole units, so f32 input survives bit for bit
/// where the offset is representable.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PointCloud {
    /// What is added to every point to get world coordinates.
    pub origin: DVec3,
    /// `[n]` positions relative to `origin`.
    pub points: Vec<Vec3>,
    /// `[n]` normals, not necessarily of unit length.
    pub normals: Option<Vec<Vec3>>,
    /// `[n]` colours: red, green, blue, alpha.
    pub colors: Option<Vec<[u8; 4]>>,
    /// Named columns of n values each.
    pub attributes: Vec<Attribute>,
}

/// A named column of a cloud.
#[derive(Debug, Clone, PartialEq)]
pub struct Attribute {
    /// Name as in the file, such as "intensity".
    pub name: String,
    /// One value a point.
    pub values: Column,
}

/// Values of an attribute in the type the file had.
#[derive(Debug, Clone, PartialEq)]
#[allow(missing_docs, reason = "the variants are the types")]
pub enum Column {
    I8(Vec<i8>),
    U8(Vec<u8>),
    I16(Vec<i16>),
    U16(Vec<u16>),
    I32(Vec<i32>),
    U32(Vec<u32>),
    F32(Vec<f32>),
    F64(Vec<f64>),
}

/// Runs one expression on the vector inside a [`Column`], whatever its type.
macro_rules! for_column {
    ($column:expr, $values:ident => $body:expr) => {
        match $column {
            Column::I8($values) => $body,
            Column::U8($values) => $body,
            Column::I16($values) => $body,
            Column::U16($values) => $body,
            Column::I32($values) => $body,
            Column::U32($values) => $body,
            Column::F32($values) => $body,
            Column::F64($values) => $body,
        }
    };
}

impl Column {
    /// Number of values.
    pub fn len(&self) -> usize {
        for_column!(self, values => values.len())
    }

    /// Whether there is no value.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Value `i` as f64 (exact for every type).
    #[allow(clippy::useless_conversion, reason = "one expression for all types, f64 among them")]
    pub fn get(&self, i: usize) -> Option<f64> {
        for_column!(self, values => values.get(i).map(|&v| f64::from(v)))
    }

    fn retain(&mut self, keep: &[bool]) {
        for_column!(self, values => retain(values, keep));
    }

    fn reordered(&self, order: &[u32]) -> Self {
        macro_rules! pick {
            ($($variant:ident),*) => {
                match self { $(Column::$variant(v) => Column::$variant(gather(v, order)),)* }
            };
        }
        pick!(I8, U8, I16, U16, I32, U32, F32, F64)
    }
}

fn retain<T>(values: &mut Vec<T>, keep: &[bool]) {
    let mut flags = keep.iter();
    values.retain(|_| *flags.next().unwrap_or(&true));
}

fn gather<T: Copy>(values: &[T], order: &[u32]) -> Vec<T> {
    order.iter().map(|&i| values[i as usize]).collect()
}

impl PointCloud {
    /// A cloud of positions at the world's origin.
    pub fn new(points: Vec<Vec3>) -> Self {
        Self { points, ..Self::default() }
    }

    /// A cloud from world coordinates.
    ///
    /// The origin is the center of the bounds rounded to whole units on every axis far from zero, and zero on the
    /// others; f32 input for which that shift would not be exact stays unshifted. NaN and infinite coordinates stay as
    /// they are, for [`PointCloud::drop_invalid`] or the index builders to report.
    pub fn from_world(coordinates: &[DVec3]) -> Self {
        let exact_from = |origin: DVec3| {
            let exact = |&c: &DVec3| !c.is_finite() || (c - origin).as_vec3().as_dvec3() + origin == c;
            coordinates.iter().all(exact)
        };
        let mut origin = Self::origin_for(coordinates);
        if origin != DVec3::ZERO && !exact_from(origin) && exact_from(DVec3::ZERO) {
            origin = DVec3::ZERO;
        }
        let points = coordinates.iter().map(|&c| (c - origin).as_vec3()).collect();
        Self { origin, points, ..Self::default() }
    }

    fn origin_for(coordinates: &[DVec3]) -> DVec3 {
        let (mut min, mut max) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for &c in coordinates.iter().filter(|c| c.is_finite()) {
            min = min.min(c);
            max = max.max(c);
        }
        if min.cmpgt(max).any() {
            return DVec3::ZERO;
        }
        // An axis whose coordinates are small beside its extent gains nothing from a shift.
        let center = (0.5 * min + 0.5 * max).round();
        let far = center.abs().cmpgt((max - min).max(DVec3::ONE));
        DVec3::select(far, center, DVec3::ZERO)
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there is no point.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// World coordinates of point `i`.
    ///
    /// # Panics
    /// If `i` is not below [`PointCloud::len`].
    pub fn world(&self, i: usize) -> DVec3 {
        self.origin + self.points[i].as_dvec3()
    }

    /// Bounds relative to `origin`; empty for no points.
    pub fn bounds(&self) -> Aabb {
        Aabb::of_points(&self.points)
    }

    /// The points relative to another origin, as needed to query one cloud with another.
    pub fn points_relative_to(&self, origin: DVec3) -> Vec<Vec3> {
        let shift = self.origin - origin;
        if shift == DVec3::ZERO {
            return self.points.clone();
        }
        self.points.iter().map(|&p| (p.as_dvec3() + shift).as_vec3()).collect()
    }

    /// Removes points with a NaN or infinite coordinate from every column; returns how many.
    pub fn drop_invalid(&mut self) -> usize {
        let keep: Vec<bool> = self.points.iter().map(|p| p.is_finite()).collect();
        let dropped = keep.iter().filter(|&&k| !k).count();
        if dropped > 0 {
            retain(&mut self.points, &keep);
            if let Some(normals) = &mut self.normals {
                retain(normals, &keep);
            }
            if let Some(colors) = &mut self.colors {
                retain(colors, &keep);
            }
            for attribute in &mut self.attributes {
                attribute.values.retain(&keep);
            }
        }
        dropped
    }

    /// The cloud with point `order[i]` at place i in every column; `order` may repeat or leave out points.
    ///
    /// # Errors
    /// `TooMany` if an entry is not below [`PointCloud::len`].
    pub fn reordered(&self, order: &[u32]) -> Result<Self> {
        if let Some(&i) = order.iter().find(|&&i| i as usize >= self.len()) {
            return Err(Error::TooMany {
                what: "point index of an order",
                found: u64::from(i),
                limit: (self.len() as u64).saturating_sub(1),
                advice: "indices count from 0 and must be below the number of points",
            });
        }
        let attribute = |a: &Attribute| Attribute { name: a.name.clone(), values: a.values.reordered(order) };
        Ok(Self {
            origin: self.origin,
            points: gather(&self.points, order),
            normals: self.normals.as_ref().map(|n| gather(n, order)),
            colors: self.colors.as_ref().map(|c| gather(c, order)),
            attributes: self.attributes.iter().map(attribute).collect(),
        })
    }

    /// Checks that every column has one value a point and that every coordinate can be searched.
    ///
    /// # Errors
    /// `LengthMismatch`, `NonFinite`, `CoordinateTooLarge`.
    pub fn validate(&self) -> Result<()> {
        let expected = self.len() as u64;
        let mut columns = vec![];
        columns.extend(self.normals.as_ref().map(|n| ("normals", n.len())));
        columns.extend(self.colors.as_ref().map(|c| ("colors", c.len())));
        columns.extend(self.attributes.iter().map(|a| ("attribute", a.values.len())));
        for (what, found) in columns {
            if found as u64 != expected {
                return Err(Error::LengthMismatch { what, found: found as u64, expected });
            }
        }
        validate::coordinates("points", &self.points)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn utm_coordinates_keep_millimetres() {
        let world: Vec<DVec3> = (0..1000)
            .map(|i| DVec3::new(637_000.001 + f64::from(i) * 0.517, 5_403_059.123_4 + f64::from(i) * 0.311, 412.007))
            .collect();
        let cloud = PointCloud::from_world(&world);
        for (i, &w) in world.iter().enumerate() {
            assert!((cloud.world(i) - w).abs().max_element() < 5e-4, "point {i}: {:?} is not {w:?}", cloud.world(i));
        }
    }

    #[test]
    fn f32_input_survives_bit_for_bit() {
        let world = [DVec3::new(637_000.5, 5_403_059.5, 1.25), DVec3::new(637_123.0, 5_403_000.0, -7.0)];
        let cloud = PointCloud::from_world(&world);
        assert_eq!([cloud.world(0), cloud.world(1)], world);
    }

    #[test]
    fn dropping_invalid_points_keeps_columns_together() {
        let mut cloud = PointCloud::new(vec![Vec3::ZERO, Vec3::new(f32::NAN, 0.0, 0.0), Vec3::ONE]);
        cloud.attributes = vec![Attribute { name: "id".into(), values: Column::U16(vec![7, 8, 9]) }];
        cloud.colors = Some(vec![[1; 4], [2; 4], [3; 4]]);
        assert!(matches!(cloud.validate(), Err(Error::NonFinite { count: 1, first: 1, .. })));
        assert_eq!(cloud.drop_invalid(), 1);
        assert_eq!(cloud.attributes[0].values, Column::U16(vec![7, 9]));
        assert_eq!(cloud.colors, Some(vec![[1; 4], [3; 4]]));
        assert!(cloud.validate().is_ok());
    }

    #[test]
    fn reordering_moves_every_column() {
        let mut cloud = PointCloud::new(vec![Vec3::ZERO, Vec3::ONE]);
        cloud.attributes = vec![Attribute { name: "t".into(), values: Column::F64(vec![0.5, 1.5]) }];
        let turned = cloud.reordered(&[1, 0]).unwrap();
        assert_eq!(turned.points, [Vec3::ONE, Vec3::ZERO]);
        assert_eq!(turned.attributes[0].values.get(0), Some(1.5));
        assert!(cloud.reordered(&[2]).is_err());
    }
}
