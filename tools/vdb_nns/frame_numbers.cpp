#include "frame_numbers.h"

#include "vdb_nns/error.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <regex>
#include <unordered_set>

namespace vdb_nns::cli {
namespace {

constexpr std::size_t kMostFrames = 100'000;
constexpr std::int64_t kLargest = 1'000'000'000;

// A place for a number: where it stands in the path, and how many digits the number has at least.
struct Place {
    std::size_t begin, end;
    int digits;
};

// Those of the file's name; if it has none, those of its folders.
std::vector<Place> placesOf(const std::string& path)
{
    static const std::regex place(R"((#+)|%(?:0(\d{1,2}))?d|\$F(\d?)(?![A-Za-z]))");
    std::vector<Place> places;
    for (std::sregex_iterator match(path.begin(), path.end(), place), end; match != end; ++match) {
        int digits = static_cast<int>((*match)[1].length());
        for (const std::size_t group : {2, 3}) {
            if ((*match)[group].length() > 0) digits = std::stoi((*match)[group].str());
        }
        const auto begin = static_cast<std::size_t>(match->position());
        places.push_back({begin, begin + static_cast<std::size_t>(match->length()), digits});
    }
    const std::size_t slash = path.rfind('/'), nameBegin = slash == std::string::npos ? 0 : slash + 1;
    const auto isInFolder = [&](const Place& place) { return place.begin < nameBegin; };
    if (!std::all_of(places.begin(), places.end(), isInFolder))
        places.erase(places.begin(), std::find_if_not(places.begin(), places.end(), isInFolder));
    return places;
}

void addRange(const std::string& text, std::vector<int>& frames)
{
    static const std::regex form(R"((-?\d{1,18})(?:-(-?\d{1,18})(?:x(\d{1,18}))?)?)");
    std::smatch match;
    if (!std::regex_match(text, match, form))
        throw InvalidInput(
            "--frames: '" + text +
            "' is no range of frames; give e.g. 1-240, 1-240x2 for every second one, or 1,5,9");
    const std::int64_t first = std::stoll(match[1].str());
    const std::int64_t last = match[2].matched ? std::stoll(match[2].str()) : first;
    const std::int64_t step = match[3].matched ? std::stoll(match[3].str()) : 1;
    if (last < first)
        throw InvalidInput("--frames: '" + text + "' holds no frame; give the smaller number first");
    if (std::min(first, -last) < -kLargest || std::max(-first, last) > kLargest)
        throw InvalidInput("--frames: '" + text + "' is out of range; frames go from -" +
                           std::to_string(kLargest) + " to " + std::to_string(kLargest));
    if (step == 0) throw InvalidInput("--frames: '" + text + "' has a step of 0; give 1 or more");
    for (std::int64_t frame = first; frame <= last; frame += step) {
        if (frames.size() == kMostFrames)
            throw InvalidInput("--frames: more than " + std::to_string(kMostFrames) +
                               " frames; give them in several runs");
        frames.push_back(static_cast<int>(frame));
    }
}

} // namespace

std::vector<int> parseFrames(const std::string& text)
{
    std::vector<int> frames;
    for (std::size_t begin = 0; begin <= text.size();) {
        const std::size_t end = std::min(text.find(',', begin), text.size());
        addRange(text.substr(begin, end - begin), frames);
        begin = end + 1;
    }
    std::unordered_set<int> seen;
    for (const int frame : frames) {
        if (!seen.insert(frame).second)
            throw InvalidInput("--frames: frame " + std::to_string(frame) + " is there twice in '" + text +
                               "'");
    }
    return frames;
}

bool isFramePattern(const std::string& path)
{
    return !placesOf(path).empty();
}

std::string pathOfFrame(const std::string& pattern, int frame)
{
    std::string path;
    std::size_t end = 0;
    for (const Place& place : placesOf(pattern)) {
        char number[128];
        std::snprintf(number, sizeof number, "%0*d", place.digits, frame);
        path += pattern.substr(end, place.begin - end) + number;
        end = place.end;
    }
    return path + pattern.substr(end);
}

} // namespace vdb_nns::cli
