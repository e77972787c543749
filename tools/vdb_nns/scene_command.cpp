// vdb_nns scene: makes a sample scene.
#include "cli_options.h"
#include "command.h"
#include "exit_codes.h"
#include "machine.h"
#include "report.h"
#include "standard_streams.h"
#include "threads.h"
#include "vdb_nns/error.h"
#include "vdb_nns/scene.h"
#include "vdb_nns/version.h"

#include <memory>
#include <nlohmann/json.hpp>

namespace vdb_nns::cli {
namespace {

struct SceneCommandFlags {
    CommonFlags common;
    SceneFlags scene;
    std::string name, output, codec = "null";
};

std::string sceneHelp()
{
    std::string text = "scene:";
    for (const SceneName& scene : sceneNames()) text += std::string(" ") + scene.name;
    return text;
}

std::string sceneListing()
{
    std::string text = "\nScenes:\n";
    for (const SceneName& scene : sceneNames()) text += format("  %-12s %s\n", scene.name, scene.what);
    return text;
}

std::string sceneJson(const SceneCommandFlags& flags, const SceneOptions& options, const Scene& scene,
                      double seconds)
{
    nlohmann::ordered_json json;
    json["schema"] = 1;
    json["version"] = VDB_NNS_VERSION;
    json["command"] = "scene";
    json["scene"] = options.name;
    json["seed"] = options.seed;
    json["points"] = scene.positions.size() / 3;
    json["suggested_radius"] = scene.suggestedRadius;
    json["voxel_size"] = scene.voxelSize;
    json["codec"] = options.codec;
    json["written"] = flags.output;
    json["seconds"] = seconds;
    return json.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
}

std::string sceneText(const SceneCommandFlags& flags, const SceneOptions& options, const Scene& scene)
{
    return line("scene", options.name + ", seed " + countText(options.seed)) +
           line("particles", countText(scene.positions.size() / 3)) +
           line("radius", shortest(scene.suggestedRadius) + " suggested") +
           line("voxel size", format("%.9g", scene.voxelSize)) + line("written", flags.output);
}

int makeAndWrite(const SceneCommandFlags& flags, const SceneOptions& options)
{
    const Stopwatch watch;
    ProgressPrinter progress(progressMode(flags.common));
    progress.begin("scene", 0, 0.5);
    const Scene scene = makeScene(options, &progress);
    progress.begin("write", 0.5, 1);
    writeScene(flags.output, scene, options, outputOptions(flags.common), &progress);
    progress.finish();
    if (!flags.common.json.empty()) {
        deliverJson(flags.common.json, sceneJson(flags, options, scene, watch.seconds()),
                    outputOptions(flags.common));
    }
    if (!flags.common.quiet && !jsonToStdout(flags.common)) writeSummary(sceneText(flags, options, scene));
    return kDone;
}

int runSceneCommand(const SceneCommandFlags& flags)
{
    SceneOptions options = sceneOptions(flags.name, flags.scene);
    options.codec = flags.codec;
    if (extensionOf(flags.output) != ".vdb") {
        throw InvalidInput(flags.output + ": a scene is written as .vdb; use -o x.vdb");
    }
    ThreadLimit threads(threadCount(flags.common));
    checkOutputs({flags.output}, {}, flags.common);
    return threads.run([&] { return makeAndWrite(flags, options); });
}

} // namespace

Command addSceneCommand(CLI::App& app)
{
    CLI::App* command = app.add_subcommand("scene", "make a sample scene");
    const auto flags = std::make_shared<SceneCommandFlags>();
    command->add_option("NAME", flags->name, sceneHelp())->required()->check(notEmpty());
    command->add_option("-o,--output", flags->output, "file to write (.vdb)")
        ->type_name("OUT")
        ->required()
        ->check(notEmpty());
    addSceneFlags(*command, flags->scene);
    command->add_option("--codec", flags->codec, "codec of P: null, trnc, fxpt16 or fxpt8")
        ->type_name("NAME")
        ->check(CLI::IsMember({"null", "trnc", "fxpt16", "fxpt8"}))
        ->capture_default_str();
    addCommonFlags(*command, flags->common);
    command->footer(sceneListing());
    return {command, [flags](Session&) { return runSceneCommand(*flags); }};
}

} // namespace vdb_nns::cli
