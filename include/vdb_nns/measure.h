// Measures: numbers made of a query's neighbors, as attributes of the points. No list is stored for them.
#pragma once

#include "vdb_nns/neighbor_lists.h"
#include "vdb_nns/particle_set.h"
#include "vdb_nns/point_values.h"
#include "vdb_nns/search_options.h"
#include "vdb_nns/types.h"

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace vdb_nns {

/// W(d) by q = min(d / R, 1), where R, the support, is the radius of the pair. The integral over space is 1.
enum class SmoothingKernel {
    kCubic,     ///< 8/(pi R^3) (1 - 6q^2 + 6q^3, from q = 1/2 on 2(1-q)^3); Monaghan and Lattanzio 1985
    kWendland2, ///< 21/(2 pi R^3) (1-q)^4 (1+4q); Wendland 1995
    kPoly6,     ///< 315/(64 pi R^3) (1-q^2)^3; Müller, Charypar and Gross 2003
    kTophat     ///< 3/(4 pi R^3)
};

/// What `pca` makes of the principal axes: points::PcaSettings of OpenVDB 13.0.
struct PcaOptions {
    double anisotropy = 0.25; ///< the least ratio of two principal lengths, in (0, 1]
    double stretch = 1;       ///< of points that have too few neighbors; finite
    std::uint32_t threshold =
        20;             ///< neighbors, with the point itself, that an ellipsoid takes; 0: there are none
    double average = 1; ///< how far positions move to the weighted mean of the neighbors, in [0, 1]
};

struct MeasureOptions {
    SmoothingKernel kernel = SmoothingKernel::kCubic;
    /// Of each candidate, >= 0 and finite; where `masses` is empty.
    double mass = 1;
    /// By particle number of the candidates' view, >= 0 and finite.
    Span<const double> masses = {};
    /// Attributes of the candidates that `average:NAME` may name, of any type but mat3s.
    std::vector<PointAttribute> attributes = {};
    PcaOptions pca = {};
    /// Of `cluster` and `cluster_size`: particles with so many neighbors are core points, and clusters are those of DBSCAN.
    std::optional<std::uint32_t> minNeighbors = {};
    /// Before the names of all results but those of `pca`.
    std::string prefix = {};
    /// `encoding` and `includeSelf` have no meaning here. `radius` and `nearest` have: measures see the neighbors that lists would
    /// hold.
    SearchOptions search = {};
};

/// The measures, named as in `vdb_nns search --attributes`. A value for each query; x_j - x_i and d = |x_j - x_i| are world
/// units, of the stored coordinates by ParticleView::distance()'s operations; m_j is a mass, a_j an attribute. Sums are over the
/// neighbors j of the query i, and over i itself where that is said and i is a candidate too.
///
///     name               type            what
///     count              int32           number of neighbors
///     density            float           sum_j m_j W(d) + m_i W(0), the latter where i is a candidate
///     mean_distance      float           of the neighbors; -1 without any
///     nearest_distance   float           of the nearest; -1 without any
///     nearest            int32           number of the nearest, in real arithmetic, of equally near ones the smallest; -1 without any
///     average:NAME       as NAME         sum W a_j / sum W, i included. Integers give float. Values that are not finite are
///                                        skipped. 0 where sum W is 0
///     normal             vec3s           sum_j W (x_i - x_j) as a unit vector; 0 where that or sum W is 0
///     eigenvalues        vec3s           of sum W (x-c)(x-c)^T / sum W, i included, about the weighted mean c; descending
///     pca                                four, as points::pca of OpenVDB 13.0 names them; weight w = 1 - (d/R)^3, i included:
///       stretch          vec3s           eigenvalues of sum w (x-c)(x-c)^T / sum w, the smaller two raised to PcaOptions::anisotropy
///                                        times the largest, divided by the cube root of their product; 1 where all are 0
///       xform            mat3s           the eigenvectors as columns, which are a rotation
///       pws              vec3d           (1 - average) x_i + average c
///       ellipsoids       group           those with PcaOptions::threshold neighbors, themselves included; others have the stretch
///                                        PcaOptions::stretch and no rotation
///     cluster            int32           number of the connected component of the pairs, whichever way a pair goes: its rank by the
///                                        smallest number in it. With minNeighbors that of DBSCAN: components of the core points, whose
///                                        rank is that of their smallest; another point goes with the core point of the
///                                        smallest number that is its neighbor or has it as one, else -1. -1 for points that
///                                        are not finite
///     cluster_size       int32           points in that cluster; 0 where there is none
///     isolated           group           finite queries without neighbors
///     nonfinite          group           points whose position is NaN or infinite
///
/// Integers of numbers have 64 bits where there are more than 2^31-1 candidates. Points that do not ask, are not finite, or have a
/// radius that reaches nobody have the values of no neighbors: 0, -1, no rotation; `pws` is their position.
///
/// A density, distance or eigenvalue beyond the range of its type is infinite, or 0. Averages, normals, `stretch` and `xform` are finite
/// for radii from 1e-140, below which moments lose terms, to 1e150, above which squares of distances are infinite.
///
/// Eigenvectors: in the first two the component of the largest magnitude (of equal ones the first) is positive, and the
/// third is their cross product. Those of equal eigenvalues are what four sweeps of cyclic Jacobi rotations leave.
///
/// The same bytes for any cells, threads, instruction set and number of lattices: a sum is one of integers, at a scale that its largest
/// term gives, with an error of at most 2^-50 of that term each (more beyond 4096 neighbors: 2^-62 of it times their number). Nothing
/// is contracted, and no library function is called but the square root.

/// What measure() gives.
struct Measured {
    /// In the order of the names, by particle number of the queries' view.
    PointValues values;
    /// Counts of neighbors (Encoding::kNone), and their statistics.
    NeighborLists counts;
    /// Averaged attributes with values that are NaN or infinite, and how many particles have one.
    struct Skipped {
        std::string attribute;
        std::uint64_t values = 0;
    };
    std::vector<Skipped> skipped;
};

/// The names of the measures; that of an average ends in ':'.
const std::vector<std::string>& measureNames();

/// Names and types of what measure() would give, without a search.
struct MeasuredNames {
    struct Value {
        std::string name;
        AttributeType type;
    };
    std::vector<Value> attributes;
    std::vector<std::string> groups;
    /// Attributes that are averaged, each once.
    std::vector<std::string> averaged;
};

/// Checks names and options that need no points. The types of averages are float until `options.attributes` has them.
/// @param measures names from measureNames(), "average:" with the name of an attribute behind.
/// @throws InvalidInput for a name that is not one (the message has the nearest), that is given twice, or for a bad option
MeasuredNames checkMeasures(const std::vector<std::string>& measures, const MeasureOptions& options = {});

/// The measures of all particles of a view, with a temporary engine: see SearchEngine::measure().
PointValues measure(const ParticleView& view, double radius, const std::vector<std::string>& measures,
                    const MeasureOptions& options = {});

} // namespace vdb_nns
