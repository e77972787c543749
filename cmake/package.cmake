# `cpack` makes two packages.
# vdb_nns-VERSION-linux-x86_64.tar.gz: the program with all libraries that it needs but the C library, for machines that
# have none of them. All of it is the component `portable`, which `cmake --install` leaves out unless asked.
#   bin/vdb_nns   bin/gpu_*.sh   lib/vdb_nns/*.so*   LICENSE README.md INSTALL.txt   share/doc/vdb_nns/*.md, licenses/*
#   with CUDA: bin/vdb_nns_former, the program with the former kernels; and with tests: bin/test_cuda_gpu
# What else goes into the archive: install(.. COMPONENT portable EXCLUDE_FROM_ALL), to bin/ if it is to be run.
# vdb-nns_VERSION_amd64.deb: what `cmake --install` installs, under /usr, for the release of Debian that it was built on.
# What it depends on is read from the program by dpkg-shlibdeps; without that tool, or with a shared vdb_nns, there is no .deb.

# The same objects, linked once more, as the program of `cmake --install` must go on to use the libraries of the system.
# DT_RPATH rather than today's DT_RUNPATH: it serves the libraries of libraries too, which so need no rpath each (CMake
# can take one out of a finished library, but not put one in), and no LD_LIBRARY_PATH comes before it.
set(portable COMPONENT portable EXCLUDE_FROM_ALL)
function(vdb_nns_portable target)
    target_link_options(${target} PRIVATE LINKER:--disable-new-dtags)
    set_target_properties(${target} PROPERTIES INSTALL_RPATH "$ORIGIN/../lib/vdb_nns")
    install(TARGETS ${target} RUNTIME_DEPENDENCY_SET portable_libraries RUNTIME DESTINATION bin ${portable})
endfunction()
get_target_property(libraries vdb_nns_cli LINK_LIBRARIES)
# vdb_nns_portable_program(target name [objects that stand before those of the libraries])
function(vdb_nns_portable_program target name)
    add_executable(${target} $<TARGET_OBJECTS:vdb_nns_cli> ${ARGN})
    target_link_libraries(${target} PRIVATE ${libraries})
    if(TARGET TBB::tbbmalloc) # which oneTBB loads by its name while it runs: linked, it comes along and is the one found
        target_link_libraries(${target} PRIVATE TBB::tbbmalloc)
        target_link_options(${target} PRIVATE LINKER:--no-as-needed)
    endif()
    set_target_properties(${target} PROPERTIES
        OUTPUT_NAME ${name} RUNTIME_OUTPUT_DIRECTORY "${PROJECT_BINARY_DIR}/portable"
        LINKER_LANGUAGE CXX) # objects alone do not tell
    vdb_nns_portable(${target})
endfunction()
vdb_nns_portable_program(vdb_nns_portable vdb_nns)
if(VDB_NNS_CUDA_BUILD)
    vdb_nns_portable_program(vdb_nns_portable_former vdb_nns_former $<TARGET_OBJECTS:vdb_nns_former_kernels>)
    if(TARGET test_cuda_gpu)
        vdb_nns_portable(test_cuda_gpu)
    endif()
endif()
if(BUILD_SHARED_LIBS)
    install(TARGETS vdb_nns RUNTIME_DEPENDENCY_SET portable_libraries
        LIBRARY DESTINATION lib/vdb_nns ${portable} NAMELINK_SKIP)
endif()
# The C library is the system's: its parts fit each other and the loader, whose path is fixed in every program.
install(RUNTIME_DEPENDENCY_SET portable_libraries
    PRE_EXCLUDE_REGEXES "^ld-linux" "^lib(c|m|mvec|pthread|dl|rt|util|resolv|anl)\\.so"
    POST_EXCLUDE_REGEXES "/libvdb_nns\\.so"
    LIBRARY DESTINATION lib/vdb_nns ${portable})
foreach(script bench check session)
    install(PROGRAMS "${PROJECT_SOURCE_DIR}/tools/gpu_${script}.sh" DESTINATION bin ${portable})
endforeach()
install(DIRECTORY "${PROJECT_BINARY_DIR}/share/vdb_nns" DESTINATION share ${portable})
install(CODE "set(library_architecture \"${CMAKE_LIBRARY_ARCHITECTURE}\")" ${portable})
install(SCRIPT "${PROJECT_SOURCE_DIR}/cmake/package_libraries.cmake" ${portable})

set(glibc "of the machine that built this")
execute_process(COMMAND getconf GNU_LIBC_VERSION OUTPUT_VARIABLE printed ERROR_QUIET OUTPUT_STRIP_TRAILING_WHITESPACE)
if(printed MATCHES "^glibc ([0-9.]+)$")
    set(glibc "${CMAKE_MATCH_1}")
endif()
configure_file("${PROJECT_SOURCE_DIR}/cmake/package_install.txt.in" "${PROJECT_BINARY_DIR}/portable/INSTALL.txt" @ONLY)
install(FILES "${PROJECT_SOURCE_DIR}/LICENSE" "${PROJECT_SOURCE_DIR}/README.md"
    "${PROJECT_BINARY_DIR}/portable/INSTALL.txt" DESTINATION . ${portable})
install(DIRECTORY "${PROJECT_SOURCE_DIR}/docs/" DESTINATION share/doc/vdb_nns ${portable}
    FILES_MATCHING PATTERN "*.md" PATTERN images EXCLUDE)

find_program(VDB_NNS_SHLIBDEPS dpkg-shlibdeps)
find_program(VDB_NNS_FILE file) # which CPack tells programs by
mark_as_advanced(VDB_NNS_SHLIBDEPS VDB_NNS_FILE)
set(CPACK_GENERATOR TGZ)
if(BUILD_SHARED_LIBS)
    message(STATUS "cpack: no .deb, as vdb_nns is a shared library here")
elseif(VDB_NNS_SHLIBDEPS AND VDB_NNS_FILE)
    list(APPEND CPACK_GENERATOR DEB)
else()
    message(STATUS "cpack: no .deb without dpkg-dev and file (tools/setup.sh --package)")
endif()
set(CPACK_SOURCE_GENERATOR TGZ)
set(CPACK_SOURCE_IGNORE_FILES "${PROJECT_SOURCE_DIR}/build" "/\\\\.git(/|$)" "/__pycache__/")
set(CPACK_PACKAGE_FILE_NAME "vdb_nns-${PROJECT_VERSION}-linux-x86_64")
set(CPACK_PACKAGE_CHECKSUM SHA256)
set(CPACK_STRIP_FILES ON)
# Which component a generator takes, and so which files, can only be said when it is known.
set(CPACK_PROJECT_CONFIG_FILE "${PROJECT_SOURCE_DIR}/cmake/package_generator.cmake")
set(CPACK_INSTALL_CMAKE_PROJECTS "${PROJECT_BINARY_DIR};${PROJECT_NAME};portable;/")
set(CPACK_INSTALL_DEFAULT_DIRECTORY_PERMISSIONS # whatever the umask
    OWNER_READ OWNER_WRITE OWNER_EXECUTE GROUP_READ GROUP_EXECUTE WORLD_READ WORLD_EXECUTE)

# The one file that a .deb has beside the plain install: where Debian looks for the licence.
install(FILES "${PROJECT_SOURCE_DIR}/LICENSE" DESTINATION "${CMAKE_INSTALL_DATADIR}/doc/vdb-nns" RENAME copyright
    COMPONENT deb EXCLUDE_FROM_ALL)
set(CPACK_PACKAGE_CONTACT "vdb_nns maintainers <maintainers@vdb-nns.invalid>")
set(CPACK_DEBIAN_PACKAGE_NAME vdb-nns)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_PACKAGE_SECTION libdevel)
set(CPACK_DEBIAN_PACKAGE_SHLIBDEPS ON)
# What a program that links the static library links too, and finds by our CMake files; Boost is for the headers of OpenVDB, whose
# package does not ask for it.
set(CPACK_DEBIAN_PACKAGE_DEPENDS "libopenvdb-dev, libblosc-dev, libtbb-dev, zlib1g-dev, libdeflate-dev, libboost-dev")
set(CPACK_DEBIAN_PACKAGE_SUGGESTS "python3-matplotlib")
set(CPACK_DEBIAN_PACKAGE_DESCRIPTION # behind the project's own, of one line
"For every particle of a point file or array, vdb_nns finds all others within a radius, exactly, out of core where
memory is short. This package has the program, the static library, its headers and CMake files.")
include(CPack)
