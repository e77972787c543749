// The standard streams.
#pragma once

#include <string>

namespace vdb_nns::cli {

/// Opens those of the descriptors 0 to 2 that are closed on /dev/null: the next file that is opened would get
/// their number, and what is said on stderr would be written into it. Before anything is opened.
/// @returns false where that cannot be done, which it says if it can
bool openStandardStreams();

/// Text of one line that does nothing to a terminal, whatever comes from files, paths and their like: control
/// characters (C0, C1, DEL) and what is not UTF-8 are written as \xNN.
std::string printable(const std::string& text);

/// Says a line on stderr: "vdb_nns: " and the text, made printable.
void say(const std::string& text);

/// Before what was asked for on standard output is made.
/// @throws OutputError when it was closed from the start
void requireStdout();

/// Writes the lines of a summary to standard output, each made printable; none where it was closed from the
/// start: nobody asked for a summary.
/// @throws OutputError when not all of it could be written
void writeSummary(const std::string& lines);

/// Writes what was asked for to standard output, as it is, and flushes it.
/// @throws OutputError when not all of it could be written, or it was closed from the start
void writeStdout(const std::string& text);

} // namespace vdb_nns::cli
