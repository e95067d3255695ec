//! Rays into the Stanford bunny, with rays and hits on the device.

use nearfield::query::Clock;

use super::bench::Bench;
use super::row::{Figure, Outcome, Value};
use crate::Result;
use crate::rays::check::Expected;
use crate::rays::method::{self, Method};
use crate::rays::shots::Question;
use crate::rays::speed::Bunny;

/// Which rays.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Shots {
    /// One through every pixel.
    Primary,
    /// One off every hit of those.
    Diffuse,
}

/// First hits by a structure; every ray is compared with the CPU's hierarchy, and that with brute force.
pub(super) fn cast(bench: &mut Bench, method: Method, shots: Shots) -> Result<Outcome> {
    let (bunny, effort) = (bench.bunny()?, bench.effort());
    let Bunny { named, scene, primary, bounces, .. } = &*bunny;
    let rays = if shots == Shots::Primary { primary } else { bounces };
    if rays.is_empty() {
        return Ok(Outcome::missing("no ray hits the mesh: the picture is too small"));
    }
    let Some(built) = scene.build(method, Some(&bench.gpu))? else { return Ok(Outcome::missing("no GPU")) };
    let expected = Expected::of(&scene.triangles, rays, Question::Closest)?;
    let cast = method::cast(&built.search, rays, Question::Closest, &expected, effort)?;
    let (timing, clock) = cast.device.map_or((cast.host, Clock::Host), |device| (device, Clock::Device));
    let rate = |milliseconds: f64| rays.len() as f64 / milliseconds * 1e-6;
    let value =
        Value { median: rate(timing.median), fastest: rate(timing.fastest), clock: Some(clock), runs: cast.runs };
    let (tests, most) = method::triangle_tests(&built.search, rays)?;
    let note = format!(
        "{} rays, {}, {} triangles; {tests:.2} triangle tests a ray, {most} at most; {} rays differ within rounding",
        rays.len(),
        named.name,
        named.triangles(),
        cast.differing
    );
    Ok(Outcome::without_neighbors(vec![Figure::value(method.name(), value).note(note)]))
}
