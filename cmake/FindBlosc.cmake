# Finds Blosc (version 1), which has no package configuration of its own. It is installed with this project, for consumers.
#
# Target:    Blosc::blosc
# Variables: Blosc_FOUND, Blosc_VERSION
# Hint:      Blosc_ROOT

find_path(Blosc_INCLUDE_DIR blosc.h)
find_library(Blosc_LIBRARY blosc)
mark_as_advanced(Blosc_INCLUDE_DIR Blosc_LIBRARY)

set(Blosc_VERSION "")
if(Blosc_INCLUDE_DIR)
    file(STRINGS "${Blosc_INCLUDE_DIR}/blosc.h" _vdb_nns_blosc REGEX "#define BLOSC_VERSION_STRING")
    if("${_vdb_nns_blosc}" MATCHES "\"([0-9.]+)")
        set(Blosc_VERSION "${CMAKE_MATCH_1}")
    endif()
endif()

include(FindPackageHandleStandardArgs)
find_package_handle_standard_args(Blosc REQUIRED_VARS Blosc_LIBRARY Blosc_INCLUDE_DIR VERSION_VAR Blosc_VERSION)

if(Blosc_FOUND AND NOT TARGET Blosc::blosc)
    add_library(Blosc::blosc UNKNOWN IMPORTED)
    set_target_properties(Blosc::blosc PROPERTIES IMPORTED_LOCATION "${Blosc_LIBRARY}"
        INTERFACE_INCLUDE_DIRECTORIES "${Blosc_INCLUDE_DIR}")
endif()
