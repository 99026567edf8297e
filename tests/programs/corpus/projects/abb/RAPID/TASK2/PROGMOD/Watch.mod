MODULE Watch
  PERS num nCycle:=4711;
  PROC main()
    WaitUntil nCycle>0;
    SetGO goCycle,nCycle;
  ENDPROC
ENDMODULE
