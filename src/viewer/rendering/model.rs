//! [`ThreadingModel`]: the threads that cull and draw.

use super::cores;

/// The environment variable that names a model for [`ThreadingModel::AutomaticSelection`].
pub const THREADING_VARIABLE: &str = "TERRANE_THREADING";

/// The threads that cull and draw; OSG's four models.
///
/// The diagrams show two contexts with one camera each; `=` is a barrier of all threads that it crosses, `#` the end of dynamic
/// draws (see [`DataVariance`](crate::state::DataVariance)), `s` the swap-ready barrier of the contexts' threads, `p` present.
///
/// ```text
/// SingleThreaded
///   main      | update | cull 0 | cull 1 | draw 0 | draw 1 | p p | update ...
///
/// CullDrawThreadPerContext
///   main      | update |=           waits           =| update ...
///   draw 0             |= cull 0 | draw 0    |s| p  =|
///   draw 1             |= cull 1 | draw 1 |   s| p  =|
///
/// DrawThreadPerContext
///   main      | update | cull 0 | cull 1 |#| update | cull 0 | cull 1 |#| ...
///   draw 0                      | draw 0       |s|p|         | draw 0   |s|p|
///   draw 1                               | draw 1|s|p|                | draw 1|s|p|
///
/// CullThreadPerCameraDrawThreadPerContext
///   main      | update |= waits #| update |= waits #| ...
///   cull 0             |= cull 0 |        |= cull 0 |
///   cull 1             |= cull 1|         |= cull 1|
///   draw 0                       | draw 0   |s|p|   | draw 0   |s|p|
///   draw 1                      | draw 1    |s|p|  | draw 1    |s|p|
/// ```
/// All models draw the same images.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum ThreadingModel {
    /// Everything on the main thread, in order: the easiest to debug.
    SingleThreaded,
    /// One thread per context culls and draws its cameras; the main thread waits until all have presented the frame.
    CullDrawThreadPerContext,
    /// The main thread culls, one thread per context draws. Drawing a frame overlaps update and cull of the next.
    DrawThreadPerContext,
    /// One thread per camera culls, one thread per context draws. Cameras are culled in parallel, and drawing overlaps.
    CullThreadPerCameraDrawThreadPerContext,
    /// The model that [`THREADING_VARIABLE`] names, or the result of [`Self::suggest_best`].
    #[default]
    AutomaticSelection,
}

impl ThreadingModel {
    /// The four models that can run.
    pub const ALL: [Self; 4] = [
        Self::SingleThreaded,
        Self::CullDrawThreadPerContext,
        Self::DrawThreadPerContext,
        Self::CullThreadPerCameraDrawThreadPerContext,
    ];

    /// Returns OSG's name of the model.
    pub const fn name(self) -> &'static str {
        match self {
            Self::SingleThreaded => "SingleThreaded",
            Self::CullDrawThreadPerContext => "CullDrawThreadPerContext",
            Self::DrawThreadPerContext => "DrawThreadPerContext",
            Self::CullThreadPerCameraDrawThreadPerContext => "CullThreadPerCameraDrawThreadPerContext",
            Self::AutomaticSelection => "AutomaticSelection",
        }
    }

    /// Returns the best model for a number of contexts, cameras and processor cores, by OSG's rule.
    pub fn suggest_best(contexts: usize, cameras: usize, cores: usize) -> Self {
        match contexts {
            _ if contexts == 0 || cameras == 0 => Self::SingleThreaded,
            1 if cores <= 1 => Self::SingleThreaded,
            1 => Self::DrawThreadPerContext,
            _ if cores >= contexts + cameras => Self::CullThreadPerCameraDrawThreadPerContext,
            _ => Self::DrawThreadPerContext,
        }
    }

    /// Reads [`THREADING_VARIABLE`]; `None` when it is not set or empty.
    pub fn from_environment() -> Result<Option<Self>, String> {
        match std::env::var(THREADING_VARIABLE) {
            Ok(name) if name.trim().is_empty() => Ok(None),
            Ok(name) => name.parse().map(Some).map_err(|e| format!("{THREADING_VARIABLE}: {e}")),
            Err(std::env::VarError::NotPresent) => Ok(None),
            Err(error) => Err(format!("{THREADING_VARIABLE}: {error}")),
        }
    }

    /// Resolves [`Self::AutomaticSelection`] to a model that can run.
    pub(in crate::viewer) fn resolved(self, contexts: usize, cameras: usize) -> Result<Self, String> {
        if self != Self::AutomaticSelection {
            return Ok(self);
        }
        Ok(match Self::from_environment()? {
            None | Some(Self::AutomaticSelection) => Self::suggest_best(contexts, cameras, cores::count()),
            Some(model) => model,
        })
    }
}

impl std::fmt::Display for ThreadingModel {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

impl std::str::FromStr for ThreadingModel {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let known = || Self::ALL.into_iter().chain([Self::AutomaticSelection]);
        let found = known().find(|model| model.name().eq_ignore_ascii_case(text.trim()));
        found.ok_or_else(|| {
            let names: Vec<_> = known().map(Self::name).collect();
            format!("`{text}` is none of {}", names.join(", "))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_round_trip() {
        for model in ThreadingModel::ALL {
            assert_eq!(model.to_string().parse(), Ok(model));
            assert_eq!(model.name().to_lowercase().parse(), Ok(model));
        }
        assert!("TwoThreads".parse::<ThreadingModel>().unwrap_err().contains("CullDrawThreadPerContext"));
    }

    #[test]
    fn best_model_depends_on_contexts_cameras_and_cores() {
        use ThreadingModel as M;
        assert_eq!(M::suggest_best(0, 0, 8), M::SingleThreaded);
        assert_eq!(M::suggest_best(2, 0, 8), M::SingleThreaded);
        assert_eq!(M::suggest_best(1, 1, 1), M::SingleThreaded);
        assert_eq!(M::suggest_best(2, 2, 1), M::DrawThreadPerContext);
        assert_eq!(M::suggest_best(1, 1, 2), M::DrawThreadPerContext);
        assert_eq!(M::suggest_best(1, 3, 16), M::DrawThreadPerContext);
        assert_eq!(M::suggest_best(3, 3, 6), M::CullThreadPerCameraDrawThreadPerContext);
        assert_eq!(M::suggest_best(3, 3, 4), M::DrawThreadPerContext);
    }
}
