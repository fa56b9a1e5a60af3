# embed_text(TARGET NAMESPACE NAME files... [NAME files...]...): compiles text files into TARGET. Each NAME (a word without
# a dot or a slash) becomes `extern const std::string_view NAME;` in the header embedded_text.h, for the target's own
# sources: its files one after another. Files are read when the target is built, not when it is configured.
set(EMBED_TEXT_SCRIPT ${CMAKE_CURRENT_LIST_DIR}/embed_text_script.cmake)

function(embed_text target namespace)
  set(names "")
  foreach(word IN LISTS ARGN)
    if(word MATCHES "[./]")
      list(APPEND files_${name} "${word}")
      list(APPEND files "${CMAKE_CURRENT_SOURCE_DIR}/${word}")
    else()
      set(name "${word}")
      list(APPEND names "${name}")
    endif()
  endforeach()
  # One argument a name, "name=file|file", as lists would be taken apart on their way through a command line.
  set(spec "")
  foreach(name IN LISTS names)
    list(JOIN files_${name} "|" joined)
    list(APPEND spec "${name}=${joined}")
  endforeach()
  list(JOIN spec "," spec)
  set(out ${CMAKE_CURRENT_BINARY_DIR}/embedded)
  add_custom_command(
    OUTPUT ${out}/embedded_text.h ${out}/embedded_text.cpp
    COMMAND ${CMAKE_COMMAND} -DOUT=${out} -DSOURCE=${CMAKE_CURRENT_SOURCE_DIR} -DNAMESPACE=${namespace} -DSPEC=${spec}
            -P ${EMBED_TEXT_SCRIPT}
    DEPENDS ${files} ${EMBED_TEXT_SCRIPT}
    COMMENT "Embedding the text files of ${target}"
    VERBATIM)
  target_sources(${target} PRIVATE ${out}/embedded_text.h ${out}/embedded_text.cpp)
  target_include_directories(${target} PRIVATE ${out})
endfunction()
