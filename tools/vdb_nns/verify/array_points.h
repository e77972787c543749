// The positions of an array or text file, by readers that share no code with the engine's: what
// PointFile::read() misunderstands, `search` and `verify` would else misunderstand alike. They are written
// from the descriptions of the formats, plainly and sequentially. A .vdb has no second reader: only OpenVDB
// knows the format, and the tests compare it with ours.
#pragma once

#include "vdb_nns/particle_view.h"
#include "vdb_nns/point_file.h"
#include "vdb_nns/point_values.h"

#include <optional>
#include <string>
#include <vector>

namespace vdb_nns::cli {

// x y z triples in the file's order. Every number that a format has is exact in double, or refused.
using Positions = std::vector<double>;

// Whether the extension is one that readArrayPoints() reads: .npy .npz .ply .vtk .bgeo .xyz .txt .csv .pts,
// in any case.
bool isArrayPointFile(const std::string& path);

// Reads such a file. Of the options, `columns`, `array` and `progress` count.
// @throws InvalidInput for a column or an array that the file does not have
// @throws InputError for a file that cannot be read or is not understood whole
// @throws Cancelled
Positions readArrayPoints(const std::string& path, const PointFileOptions& options = {});

// A property of element `vertex` of a .ply, one number a vertex.
// @throws InputError for a file that is not understood whole, and for a property that is not there once or is a list
std::vector<double> readPlyScalars(const std::string& path, const std::string& property,
                                   const PointFileOptions& options = {});

// The numbers of an .npy of shape (N,) or (N, 1), of 4 or 8 bytes.
// @throws InputError for another file
std::vector<double> readNpyNumbers(const std::string& path, const PointFileOptions& options = {});

// Names of the arrays of an .npz, in the order of the file.
// @throws InputError for a file that is no .npz
std::vector<std::string> listNpzArrays(const std::string& path);

// One of them as values of points: an attribute of rows of 1, 3 or 9 numbers, or a group of bools.
// @throws InputError for another array, and for a file that is damaged
PointValues readNpzValues(const std::string& path, const std::string& array,
                          const PointFileOptions& options = {});

// The sentence about the first of the values of the points of `path` that two readers understand differently, or about their
// number; nothing where all are the same.
std::optional<std::string> findDifference(const std::string& path, const std::vector<double>& engine,
                                          const std::vector<double>& own);

// The sentence about the first point that two readers of `path` understand differently, or about their number
// of points; nothing where all coordinates are the same to the bit, NaN being the same as NaN.
std::optional<std::string> findDifference(const std::string& path, const ParticleView& engine,
                                          const Positions& own);

} // namespace vdb_nns::cli
