MODULE Chosen
  CONST robtarget pLeft:=<26|gripper|table>;
  CONST robtarget pRight:=<27|gripper|table>;
  VAR robtarget pNext;
  PROC main()
    IF diLeft=1 THEN
      pNext:=pLeft;
    ELSE
      pNext:=pRight;
    ENDIF
    MoveJ Offs(pNext,0,0,80),v1000,z10,gripper\WObj:=table;
    MoveL pNext,v100,fine,gripper\WObj:=table;
  ENDPROC
ENDMODULE
