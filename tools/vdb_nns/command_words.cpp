#include "command_words.h"

#include <algorithm>
#include <cstddef>

namespace vdb_nns::cli {
namespace {

// Letters to be changed, left out, put in or exchanged with the next one until a word is another.
std::size_t editDistance(const std::string& a, const std::string& b)
{
    std::vector<std::vector<std::size_t>> d(a.size() + 1, std::vector<std::size_t>(b.size() + 1));
    for (std::size_t i = 0; i <= a.size(); ++i) {
        for (std::size_t j = 0; j <= b.size(); ++j) {
            if (i == 0 || j == 0) {
                d[i][j] = i + j;
                continue;
            }
            const std::size_t changed = d[i - 1][j - 1] + (a[i - 1] != b[j - 1]);
            d[i][j] = std::min({d[i - 1][j] + 1, d[i][j - 1] + 1, changed});
            const bool isExchanged = i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1];
            if (isExchanged) d[i][j] = std::min(d[i][j], d[i - 2][j - 2] + 1);
        }
    }
    return d[a.size()][b.size()];
}

bool isFlag(const std::string& word)
{
    return word.rfind("--", 0) == 0;
}

// What may stand where the word stands.
std::vector<std::string> namesFor(const std::string& word, const CLI::App& root, const CLI::App& command)
{
    std::vector<std::string> names;
    if (isFlag(word)) {
        for (const CLI::Option* option : command.get_options()) {
            for (const std::string& name : option->get_lnames()) names.push_back("--" + name);
        }
    } else if (&command == &root) {
        names.push_back("help");
        for (const CLI::App* each : root.get_subcommands([](const CLI::App*) { return true; }))
            names.push_back(each->get_name());
    }
    return names;
}

} // namespace

std::string nearestName(const std::string& word, const std::vector<std::string>& names)
{
    constexpr std::size_t kShortestWord = 3, kMostEdits = 2;
    std::string nearest;
    std::size_t least = kMostEdits + 1;
    if (word.size() < kShortestWord) return nearest;
    for (const std::string& name : names) {
        const std::size_t edits = name.rfind(word, 0) == 0 ? 0 : editDistance(word, name);
        if (edits < least) nearest = name, least = edits;
    }
    return nearest;
}

std::vector<std::string> withHelp(std::vector<std::string> words)
{
    const auto isHelp = [](const std::string& word) { return word == "help"; };
    const auto command = std::find_if_not(words.begin(), words.end(), isHelp);
    const bool isAsked = command != words.begin() || words.empty();
    words.erase(words.begin(), command);
    if (isAsked) words.push_back("--help");
    return words;
}

std::string unknownWords(const CLI::App& app)
{
    const std::vector<std::string> words = app.remaining(true);
    if (words.empty()) return {};
    const CLI::App& command = app.get_subcommands().empty() ? app : *app.get_subcommands().front();
    const std::string name = &command == &app ? app.get_name() : app.get_name() + " " + command.get_name();
    std::string text = name + " does not know";
    std::string suggestion;
    for (const std::string& word : words) {
        text += " " + word;
        if (suggestion.empty())
            suggestion = nearestName(word.substr(0, word.find('=')), namesFor(word, app, command));
    }
    if (!suggestion.empty()) text += "; did you mean '" + suggestion + "'?";
    return text + "; see " + name + " --help";
}

} // namespace vdb_nns::cli
