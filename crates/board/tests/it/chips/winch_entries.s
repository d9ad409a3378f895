; Where crates/board/tests/it/chips/winch_avr.rs calls the winch's assembly.
.section .vectors, "ax", @progbits
    jmp winch_tick
    jmp winch_listen
    jmp winch_obey
    jmp winch_say
    jmp winch_status
    jmp winch_start
