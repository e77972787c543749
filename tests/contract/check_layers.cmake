# The layers of src/ARCHITECTURE.md, as far as #include lines show them.
function(forbid pattern why)
    foreach(file IN LISTS ARGN)
        file(STRINGS "${file}" lines REGEX "${pattern}")
        if(lines)
            file(RELATIVE_PATH name "${SOURCE_DIR}" "${file}")
            message(SEND_ERROR "${name}: ${why}: ${lines}")
        endif()
    endforeach()
endfunction()

set(openvdb "# *include *[<\"](openvdb|nanovdb)/")
set(host "# *include *[<\"](tbb|oneapi|boost|Eigen)/")
set(device "# *include *[<\"](cuda[_.a-z0-9]*|cub|thrust|cuda/std)[/>\"]|__global__|__device__")

file(GLOB_RECURSE public "${SOURCE_DIR}/include/vdb_nns/*")
forbid("${host}|${device}" "a public header needs the standard library alone" ${public})
list(FILTER public EXCLUDE REGEX "openvdb_bridge\\.h$")
forbid("${openvdb}" "only the bridge header may include OpenVDB" ${public})

file(GLOB_RECURSE kernels "${SOURCE_DIR}/kernels/*")
forbid("${openvdb}|${host}" "kernels know neither OpenVDB nor TBB" ${kernels})
file(GLOB_RECURSE shared "${SOURCE_DIR}/kernels/shared/*")
list(FILTER shared EXCLUDE REGEX "annotation\\.h$")
forbid("${device}" "kernels/shared is C++ that any compiler reads" ${shared})

file(GLOB_RECURSE source "${SOURCE_DIR}/src/*.cpp" "${SOURCE_DIR}/src/*.h")
forbid("__global__|__device__|cuda_runtime" "src has no device code" ${source})
forbid("std::(abort|exit|terminate) *\\(|[^a-z_]exit *\\(|std::c(out|err)|[^a-zA-Z_]f?printf *\\("
    "the library never prints and never exits" ${source})

# The folders of src in the order of the data. None includes one that stands after it.
set(order util points grid exact lists search measure plan out_of_core io scene job)
file(GLOB folders RELATIVE "${SOURCE_DIR}/src" "${SOURCE_DIR}/src/*")
list(FILTER folders EXCLUDE REGEX "\\.(md|txt)$")
list(REMOVE_ITEM folders ${order})
if(folders)
    message(SEND_ERROR "src: folders that the order of the data does not name: ${folders}")
endif()
set(after ${order})
foreach(folder IN LISTS order)
    list(REMOVE_ITEM after ${folder})
    list(JOIN after "|" pattern)
    file(GLOB_RECURSE files "${SOURCE_DIR}/src/${folder}/*")
    if(pattern)
        forbid("# *include *\"(\\.\\./)*(${pattern})/" "src/${folder} stands before that in the order of the data" ${files})
    endif()
endforeach()
list(JOIN order "|" inner)
list(REMOVE_ITEM order util) # a kernel reads the build's configuration, which is made there
list(JOIN order "|" but_util)
forbid("# *include *\"(\\.\\./)*(src/)?(${but_util})/" "kernels know nothing of src" ${kernels})

file(GLOB_RECURSE tools "${SOURCE_DIR}/tools/vdb_nns/*.cpp" "${SOURCE_DIR}/tools/vdb_nns/*.h"
    "${SOURCE_DIR}/tools/bench/*.cpp" "${SOURCE_DIR}/tools/bench/*.h")
forbid("# *include *\"(\\.\\./)*(src/)?(${inner})/" "tools call only the public headers" ${tools})
list(FILTER tools EXCLUDE REGEX "/tools/bench/")
forbid("# *include *\"(shared|cpu|cuda)/" "tools call only the public headers" ${tools})
