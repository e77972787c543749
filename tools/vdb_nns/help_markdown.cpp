#include "help_markdown.h"

namespace vdb_nns::cli {
namespace {

// A bar ends a table cell.
std::string cell(const std::string& text)
{
    std::string escaped;
    for (const char c : text) {
        if (c == '|') escaped += '\\';
        escaped += c;
    }
    return escaped;
}

std::string row(const CLI::Option& option)
{
    std::string name = option.get_name(option.get_positional(), true);
    for (std::size_t at = name.find(','); at != std::string::npos; at = name.find(',', at + 1)) {
        name.insert(at + 1, " ");
    }
    const bool takesValue = option.get_items_expected_max() > 0;
    const std::string value = takesValue && !option.get_positional() ? " " + option.get_type_name() : "";
    const std::string standard = takesValue ? option.get_default_str() : "";
    return "| `" + cell(name + value) + "` | " + cell(option.get_description()) +
           (standard.empty() ? "" : " (default `" + cell(standard) + "`)") + " |\n";
}

} // namespace

std::string helpMarkdown(const CLI::App& app)
{
    std::string text;
    for (const CLI::App* command : app.get_subcommands([](const CLI::App*) { return true; })) {
        text += (text.empty() ? "### `" : "\n### `") + app.get_name() + " " + command->get_name() + "`\n\n" +
                command->get_description() + "\n\n| flag | what |\n|---|---|\n";
        for (const CLI::Option* option : command->get_options()) {
            if (option->get_name().find("--help") == std::string::npos) text += row(*option);
        }
    }
    return text;
}

} // namespace vdb_nns::cli
