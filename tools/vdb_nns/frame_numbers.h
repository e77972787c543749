// Numbers of frames, and names of files that hold such a number.
#pragma once

#include <string>
#include <vector>

namespace vdb_nns::cli {

/// The frames of `--frames`: 7, 1-240, 1-240x2 (1, 3, .. 239), or several of these with commas between; in the order given.
/// @throws InvalidInput for another text, a range without a frame, a frame that is there twice, and more than 100000 frames
std::vector<int> parseFrames(const std::string& text);

/// Whether a path has a place for the number of a frame: #### (as many digits as there are # at least), %d or %04d as printf()
/// has them, $F or $F4 as Houdini has them. Places in folders count where the file's name has none.
bool isFramePattern(const std::string& path);

/// The path of a frame: each place of `pattern` gets the number. A path without a place is that of every frame.
std::string pathOfFrame(const std::string& pattern, int frame);

} // namespace vdb_nns::cli
