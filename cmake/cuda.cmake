# VDB_NNS_CUDA=AUTO|ON|OFF decides what kernels/ is built from. Sets
#   VDB_NNS_CUDA_BUILD  whether CUDA is built
#   VDB_NNS_CUDA_WHY    the reason, in words, for --version
#   VDB_NNS_CUDA_BUILT_FOR  the architectures
# and enables the language. AUTO says what it found; ON fails without a compiler that works; OFF links the stub.

set(VDB_NNS_CUDA AUTO CACHE STRING "Build the CUDA kernels: AUTO (when there is a compiler), ON or OFF")
set_property(CACHE VDB_NNS_CUDA PROPERTY STRINGS AUTO ON OFF)
if(NOT VDB_NNS_CUDA MATCHES "^(AUTO|ON|OFF)$")
    message(FATAL_ERROR "VDB_NNS_CUDA is '${VDB_NNS_CUDA}'; it must be AUTO, ON or OFF")
endif()

set(VDB_NNS_CUDA_BUILD FALSE)
if(VDB_NNS_CUDA STREQUAL "OFF")
    set(VDB_NNS_CUDA_WHY "VDB_NNS_CUDA=OFF")
else()
    find_program(VDB_NNS_NVCC nvcc HINTS ENV CUDACXX PATHS /usr/local/cuda/bin /opt/cuda/bin
        DOC "The CUDA compiler")
    if(NOT EXISTS "${VDB_NNS_NVCC}")
        set(VDB_NNS_CUDA_WHY "no nvcc on PATH or in /usr/local/cuda/bin")
    else()
        # check_language() tries the compiler in a project of its own, so that a broken one does not end this run.
        set(ENV{CUDACXX} "${VDB_NNS_NVCC}")
        if(NOT CMAKE_CUDA_COMPILER)
            unset(CMAKE_CUDA_COMPILER CACHE)
        endif()
        if(NOT DEFINED CMAKE_CUDA_HOST_COMPILER AND CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
            set(CMAKE_CUDA_HOST_COMPILER "${CMAKE_CXX_COMPILER}")
        endif()
        include(CheckLanguage)
        check_language(CUDA)
        if(CMAKE_CUDA_COMPILER)
            if(NOT DEFINED CMAKE_CUDA_ARCHITECTURES)
                # Machine code for Turing to both of Blackwell's, and PTX for what comes after.
                set(CMAKE_CUDA_ARCHITECTURES 75-real 80-real 86-real 89-real 90-real 100 120-real
                    CACHE STRING "CUDA architectures")
            endif()
            list(TRANSFORM CMAKE_CUDA_ARCHITECTURES REPLACE "-real" "" OUTPUT_VARIABLE VDB_NNS_CUDA_BUILT_FOR)
            list(TRANSFORM VDB_NNS_CUDA_BUILT_FOR PREPEND "sm_")
            list(JOIN VDB_NNS_CUDA_BUILT_FOR " " VDB_NNS_CUDA_BUILT_FOR)
            enable_language(CUDA)
            find_package(CUDAToolkit QUIET)
            if(TARGET CUDA::cudart_static)
                set(VDB_NNS_CUDA_BUILD TRUE)
                set(VDB_NNS_CUDA_WHY "${VDB_NNS_NVCC}, ${CMAKE_CUDA_COMPILER_VERSION}")
            else()
                set(VDB_NNS_CUDA_WHY "${VDB_NNS_NVCC} has no static runtime library (libcudart_static.a)")
            endif()
        else()
            set(VDB_NNS_CUDA_WHY "${VDB_NNS_NVCC} cannot compile a test program")
        endif()
    endif()
    if(VDB_NNS_CUDA STREQUAL "ON" AND NOT VDB_NNS_CUDA_BUILD)
        message(FATAL_ERROR "VDB_NNS_CUDA=ON, but CUDA cannot be built: ${VDB_NNS_CUDA_WHY}. "
            "Install a CUDA toolkit or set VDB_NNS_NVCC to its compiler, or use VDB_NNS_CUDA=AUTO or OFF.")
    endif()
endif()
if(VDB_NNS_CUDA_BUILD)
    message(STATUS "CUDA: built (${VDB_NNS_CUDA_WHY})")
else()
    message(STATUS "CUDA: absent (${VDB_NNS_CUDA_WHY})")
endif()
